"""How many paths stage 1 needs before its density on caustic_failure can be relied on.

Density maps of `ours` at the start values from 1, 4, 16 … looks of one path a cell, each against
the map of the most looks: the total variation distance, which is the share of draws that would be
sent elsewhere. Another scene, dodoco, stands beside it.

Writes results/caustic.csv and the maps as caustic_densities.png.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from isas_cli.runtime import backend

RESULTS = Path(__file__).parent / "results"
SCENES = ["caustic_failure", "dodoco"]
SHOWN = (1, 16, 256)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--most", type=int, default=4096, help="looks of the reference, a power of 4"
    )
    parser.add_argument("--resolution", type=int, default=128, help="cells a side")
    chosen = parser.parse_args()
    if chosen.most not in [4**n for n in range(16)] or chosen.most <= max(SHOWN):
        parser.error(f"--most={chosen.most}: a power of 4 above {max(SHOWN)}")
    backend.start()
    import pages
    import pandas

    rows, maps = [], {}
    for scene in SCENES:
        found, maps[scene] = measured(scene, chosen)
        rows += found
    table = pandas.DataFrame(rows)
    table.to_csv(RESULTS / "caustic.csv", index=False, float_format="%.4g")
    pages.write()
    print(table.to_string(index=False))
    drawn(maps, RESULTS / "caustic_densities.png")


def measured(scene: str, chosen: argparse.Namespace) -> tuple[list[dict], dict]:
    """Rows of the table, and density maps by number of looks."""
    import drjit as dr
    import mitsuba as mi
    import numpy as np
    from _child import problem_of

    from isas_cli.losses import L2
    from isas_cli.samplers.ours import Ours
    from isas_cli.samplers.sampler import Stage1Settings

    problem, _ = problem_of([f"scene={scene}"])
    stage1 = Stage1Settings(resolution=chosen.resolution)
    sampler = Ours(stage1=stage1).on(problem, L2(), 65536)
    starts = problem.unknowns.starts()
    total, densities = [mi.Color3f(0), mi.Color3f(0)], {}
    for look in range(1, chosen.most + 1):
        images = sampler.measured(starts, 1, look)
        total = [a + b for a, b in zip(total, images)]
        dr.eval(total)
        if look & (look - 1) == 0 and look.bit_length() % 2:
            weights = np.array(sampler.weighed([t / look for t in total]), np.float64)
            densities[look] = weights / weights.sum()
    problem.unknowns.write(starts)
    reference = densities[max(densities)]
    rows = [
        {"scene": scene, "looks": n, "distance": 0.5 * np.abs(p - reference).sum()}
        for n, p in densities.items()
    ]
    shape = sampler.cells.sizes[0][::-1]
    count = shape[0] * shape[1]
    return rows, {n: (p[:count] * len(p)).reshape(shape) for n, p in densities.items()}


def drawn(maps: dict, path: Path) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    shown = [*SHOWN, max(next(iter(maps.values())))]
    canvas = Figure(figsize=(2.3 * len(shown), 2.5 * len(maps)), layout="constrained", dpi=100)
    grid = canvas.subplots(len(maps), len(shown), squeeze=False)
    for row, (scene, by_looks) in zip(grid, maps.items()):
        for axes, looks in zip(row, shown):
            picture = axes.imshow(by_looks[looks], norm=LogNorm(0.05, 50, clip=True))
            axes.set(xticks=[], yticks=[], title=f"{looks} paths a cell")
        row[0].set_ylabel(scene)
    canvas.colorbar(picture, ax=grid, label="probability relative to uniform", shrink=0.8)
    canvas.savefig(path)


if __name__ == "__main__":
    main()
