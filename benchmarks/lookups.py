"""What a step spends on looking up pictures: time of an estimate with smaller ones.

On some scenes, all effects and four light samples at the first hit: over the time with everything
as it is, that with textures that are not unknown held as one texel; with the map of the sky at half
its width and height, which are fewer bytes than half precision would leave; and with it as small as
`scene/flat.py` makes one of a single colour. Bounds of what smaller formats could save: radiance is
another in all three. Sides take turns; medians of the turns' ratios. Writes results/lookups.csv.

    .venv/bin/python benchmarks/lookups.py
"""

from __future__ import annotations

import argparse
import statistics
import sys

import _contest
import _rows
import pages
from reproduce import RESULTS

SCENES = ("pottery", "bowl", "catcake", "earth")
SIDES = ("as it is", "textures", "half", "least")
TURNS, LANES = 5, 1 << 16


def measure(scene: str) -> None:
    from isas_cli.runtime import backend

    backend.start()
    import mitsuba as mi
    from _child import problem_of

    from isas_cli import losses
    from isas_cli.effects import probe
    from isas_cli.rendering.integrators import Paths
    from isas_cli.scene import flat
    from isas_cli.unknowns.parameters import as_numpy, owner

    probe._LEAST_BATCHES = probe._MOST_BATCHES = 16
    probe._LANES = LANES
    sides = {}
    for side in SIDES:
        problem, _ = problem_of([f"scene={scene}", "target.spp=4"])
        params = mi.traverse(problem.scene)
        for key, value in list(params.items()):
            if key in problem.unknowns.keys or getattr(value, "ndim", 0) != 3:
                continue
            is_map = isinstance(owner(params, key), mi.Emitter)
            if is_map and side in ("half", "least"):
                least = [n // 2 for n in value.shape[:2]] if side == "half" else flat._MAP
            elif not is_map and side == "textures":
                least = flat._TEXTURE
            else:
                continue
            params[key] = type(value)(_coarser(as_numpy(value), least))
        params.update()
        depth = problem.integrator.max_depth
        paths = Paths(depth, depth, (4, 4))
        measured = probe.Probe(problem, losses.L2(), 0)
        sides[side] = measured, measured._kernel(problem.integrator.cut(paths), False), paths
    seconds = {side: [] for side in SIDES}
    for turn in range(TURNS + 1):
        for side, (measured, kernel, paths) in sides.items():
            spent = measured._repeated(kernel, paths, fixed=True)[2]
            if turn:  # the first warms up
                seconds[side].append(spent)
    row = {"scene": scene}
    for side in SIDES[1:]:
        pairs = zip(seconds[side], seconds[SIDES[0]])
        row[side] = statistics.median(a / b for a, b in pairs)
    _rows.emit(row)


def _coarser(texels, size):
    """Block means of ``texels (H, W, C)``, ``size`` rows and columns."""
    import numpy as np

    for axis, count in enumerate(size):
        parts = np.array_split(texels, count, axis=axis)
        texels = np.concatenate([part.mean(axis=axis, keepdims=True) for part in parts], axis=axis)
    return np.ascontiguousarray(texels, np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", choices=SCENES, help="this one alone, in this process")
    chosen = parser.parse_args()
    if chosen.scene:
        return measure(chosen.scene)
    import pandas

    for scene in SCENES:
        rows = _rows.collect([sys.executable, __file__, "--scene", scene])
        print(rows, flush=True)
        _contest.write(RESULTS / "lookups.csv", pandas.DataFrame(rows))
    pages.write()


if __name__ == "__main__":
    main()
