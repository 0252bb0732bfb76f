"""From a Mitsuba scene of one's own to what was unknown in it.

    python examples/own_scene.py [SETTING…]

Targets are rendered from the file's own values; with photographs, add
"scene.targets=[front.exr,right.exr,left.exr]", a picture a sensor. Settings are as for `isas run`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import isas_cli

SCENE = Path(__file__).with_name("own_scene.xml")
# `isas unknowns own_scene.xml` lists what there is to be found; these are its keys.
COLOUR, ROUGHNESS = "ball.bsdf.base_color.value", "ball.bsdf.roughness.value"


def main(*settings: str) -> isas_cli.records.Run:
    run = isas_cli.run(
        "scene=file",
        f"scene.path={SCENE}",
        f'scene.unknowns={{"{COLOUR}": {{"start": 0.5}}, "{ROUGHNESS}": {{"start": 0.8}}}}',
        "budget.seconds=20",
        *settings,
    )
    for key, value in run.parameters().items():
        print(f"{key}: {value.ravel().round(3).tolist()}")
    first, last = (run.history.parameter_rmse.iloc[row] for row in (0, -1))
    print(f"parameter error {first:.3g} → {last:.3g}; pictures: {run.folder / 'report.html'}")
    return run


if __name__ == "__main__":
    main(*sys.argv[1:])
