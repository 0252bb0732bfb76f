"""Run folders with a known history, for tests of what is made from records."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from isas_cli.records import Run, RunWriter, load

KEY = "jar.bsdf.base_color.data"
PATHS_PER_SECOND = 1000


def configuration(sampler: str, seed: int, settings: dict[str, Any]) -> dict[str, Any]:
    """A resolved configuration; ``settings`` by dotted key on top of it, ``scene.unknowns.lr`` and
    its like meaning the one unknown's."""
    config: dict[str, Any] = {
        "scene": {
            "name": "pottery",
            "description": "a jar",
            "sizes": {"tiny": {"views": 2}},
            "arguments": {"views": 2},
            "unknowns": {KEY: {"start": 0.5, "range": [0, 1], "lr": None}},
        },
        "sampler": {"name": sampler, "_target_": f"isas_cli.samplers.{sampler}"},
        "loss": {"name": "l2", "_target_": "isas_cli.losses.L2"},
        "size": "tiny",
        "name": f"seed{seed}",
        "seed": seed,
        "threads": 0,
        "target": {"spp": 128, "seed": 0},
        "budget": {"seconds": 60, "iterations": None},
        "optimizer": {"lr": 0.02},
    }
    for key, value in settings.items():
        *groups, last = key.split(".")
        place = config
        if key.startswith("scene.unknowns."):  # of the one unknown, whose key has dots itself
            groups, place = [], config["scene"]["unknowns"][KEY]
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = value
    return config


def write(
    folder: Path,
    seconds: Any,
    image: Any,
    parameter: Any = None,
    *,
    sampler: str = "ours",
    seed: int = 1,
    status: str | None = "done",
    settings: dict[str, Any] | None = None,
    manifest: dict[str, Any] | None = None,
    summary: dict[str, Any] | None = None,
    columns: dict[str, Any] | None = None,
) -> Path:
    """Writes a run whose errors at ``seconds`` were ``image`` and ``parameter`` (None: no truth).

    ``status`` None: the run was killed before its summary. ``columns``: more columns of the
    history, by name.
    """
    writer = RunWriter(folder)
    writer.config(yaml.safe_dump(configuration(sampler, seed, settings or {})))
    machine = {"machine": {"device": "one"}, "threads": 2, "variant": "llvm_ad_rgb"}
    hashes = {"scene_hash": "s" * 32, "target_hash": "t" * 32}
    writer.manifest(
        {**machine, **hashes, "started": "2026-01-01T00:00:00+00:00"} | (manifest or {})
    )
    for row, second in enumerate(seconds):
        values = {
            "iteration": 10 * row,
            "seconds": float(second),
            "paths": int(PATHS_PER_SECOND * second),
            "loss": image[row],
            "image_rmse": image[row],
            "parameter_rmse": None if parameter is None else parameter[row],
            "nonfinite": 0,
            "stage1_seconds": 0.1 * float(second),
            "learning_rate": 0.02,
        }
        writer.evaluation(values | {name: cells[row] for name, cells in (columns or {}).items()})
    if status is not None:
        writer.summary({"status": status, "scene": "pottery", "seed": seed} | (summary or {}))
    return folder


def power_law(folder: Path, scale: float = 1.0, end: float = 100.0, **more: Any) -> Path:
    """A run whose errors are 1 at the start and (t / scale)^(-1/2) from t = scale on, as far as
    ``end``: each halving costs four times as many seconds as the one before."""
    seconds = np.concatenate([[0.0], np.geomspace(scale, end, 7)])
    error = np.minimum(1.0, np.sqrt(scale / np.maximum(seconds, 1e-9)))
    return write(folder, seconds, error, 2 * error, **more)


def run(folder: Path, *arguments: Any, **more: Any) -> Run:
    """`write`, and read back."""
    return load(write(folder, *arguments, **more))
