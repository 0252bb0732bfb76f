"""Run folders with histories, phases and pictures, for tests of what a comparison shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import synthetic_runs as synthetic

from isas_cli.records import safe_name
from isas_cli.runtime.images import write_exr

SIDE = 24
PHASES = {"stage1": 0.5, "step": 9.5}
UNBILLED = {"load": 0.25, "rehearsal": 1.25, "evaluation": 2.0}
RGB = ["R", "G", "B"]


def write(
    folder: Path,
    error: list[float],
    *,
    seconds: list[float] | None = None,
    truth: bool = True,
    snapshots: dict[int, float] | None = None,
    pictures: bool = True,
    **more: Any,
) -> Path:
    """A run whose image error was `error` at `seconds` (default: 0, 1, 2, 4, …), the parameters'
    twice that, if there is a `truth`.

    snapshots: grey level of the picture saved on the way, by row of the history. Its other pictures
    are grey too: target 0.5, start 0.1, result 0.5 + the last error.
    """
    if seconds is None:
        seconds = [0.0] + [2.0**row for row in range(len(error) - 1)]
    columns = {
        "gradient_norm": [None] + [0.1 / row for row in range(1, len(error))],
        "gradient_noise": [None] + [0.01 / row for row in range(1, len(error))],
        "nonfinite": [min(row, 3) for row in range(len(error))],
    }
    summary = {"seconds_by_phase": PHASES, "seconds_unbilled": UNBILLED}
    twice = [2 * value for value in error] if truth else None
    synthetic.write(folder, seconds, error, twice, columns=columns, summary=summary, **more)
    if pictures:
        frames(folder, error[-1], truth)
    for row, level in (snapshots or {}).items():
        stamp = {"iteration": 10 * row, "seconds": seconds[row]}
        grey(folder / f"frames/progress_v00_i{10 * row:06d}.exr", level, stamp)
    return folder


def frames(folder: Path, error: float, truth: bool) -> None:
    levels = {"target": 0.5, "start": 0.1, "result": 0.5 + error, "error": error}
    for name, level in levels.items():
        grey(folder / f"frames/{name}_v00.exr", level)
    density = np.linspace(0.2, 4.0, SIDE * SIDE).reshape(SIDE, SIDE)
    write_exr(folder / "frames/density_v00.exr", density, ["Y"], {})
    textures = {"truth": 0.8, "start": 0.5, "result": 0.8 - error}
    for name, level in textures.items():
        if truth or name != "truth":
            grey(folder / f"frames/{name}_{safe_name(synthetic.KEY)}.exr", level)


def grey(path: Path, level: float, metadata: dict[str, Any] | None = None) -> None:
    path.parent.mkdir(exist_ok=True)
    write_exr(path, np.full((SIDE, SIDE, 3), level), RGB, metadata or {})


def two_scenes(folder: Path) -> Path:
    """pottery with three methods of three seeds, the slowest of which reaches less than the others
    and the last of which ends early; dodoco with two methods of one seed."""
    errors = {
        "uniform": [1.0, 0.8, 0.6, 0.4, 0.3, 0.2],
        "ours": [1.0, 0.6, 0.4, 0.2, 0.15, 0.1],
        "gradient": [1.0, 0.9, 0.8, 0.7, 0.65, 0.6],
    }
    for sampler, error in errors.items():
        for seed in (1, 2, 3):
            rows = len(error) - (sampler == "gradient" and seed == 3)
            own = [1.0] + [value * (1 + 0.05 * seed) for value in error[1:rows]]
            place = folder / "pottery" / sampler / f"seed{seed}"
            write(place, own, snapshots={0: 0.1, 2: 0.3, 4: 0.5}, sampler=sampler, seed=seed)
    scene = {"scene.name": "dodoco"}
    for sampler in ("uniform", "ours"):
        place = folder / "dodoco" / sampler / "seed1"
        more = {"settings": scene, "manifest": {"target_hash": "d" * 32}}
        write(place, errors[sampler], truth=False, sampler=sampler, **more)
    return folder
