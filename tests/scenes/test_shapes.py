"""Scenes whose shapes are unknown: a few steps, as configured."""

from __future__ import annotations

import re

import numpy as np
import pytest
import trimesh
from runs_for_tests import resumed
from test_tiny_scenes import SHAPES, SMALL

import isas_cli
from isas_cli.engine.recorder import Recorder
from isas_cli.runtime.errors import InputError
from isas_cli.scene import shape_error
from isas_cli.scene.shape_error import Sampled

SETTINGS = [each for each in SMALL if "budget" not in each and "batch" not in each]
SETTINGS += ["frames.views=0", "frames.snapshots=0", "report=false", "evaluation.spp=8"]


@pytest.mark.parametrize("scene, sampler", list(zip(SHAPES, ("uniform", "ours", "uniform"))))
def test_a_sphere_becomes_the_figure(scene, sampler, tmp_path):
    chosen = [f"scene={scene}", f"sampler={sampler}", "estimator=silhouettes"]
    pictured = scene == SHAPES[0]  # one turntable tells as much as three
    run = isas_cli.run(
        *chosen, *SETTINGS, "estimator.batch=4096", "budget.iterations=150", "target.spp=64",
        "optimizer.schedule=cosine", "optimizer.final=0.1", f"frames.views={pictured:d}",
        f"hydra.run.dir={tmp_path}",
    )  # fmt: skip
    error = run.history["parameter_rmse"]
    assert error.iloc[-1] < 0.55 * error.iloc[0]  # seen: 0.25, 0.41, 0.39
    last = run.history.iloc[-1]
    assert last["value/figure.vertices/folded"] == 0 and last["nonfinite"] == 0
    assert 0.9 < last["value/figure.vertices/volume"] < 1.1
    first = run.history.iloc[0]
    for name in ("value/figure.vertices/overlap", "value/outlines/overlap"):
        # All of a small image's pixels can be right in the end.
        assert first[name] < 1 and first[name] < last[name] <= 1
    files = {path.name for path in (tmp_path / "meshes").iterdir()}
    kinds = [f"{what}_figure.vertices.{kind}" for what in ("start", "result", "truth")
             for kind in ("ply", "obj")]  # fmt: skip
    assert files == {*kinds, *["turntable_figure.vertices.webp"] * pictured}


def test_mitsubas_loop_recovers_it_too(tmp_path):
    run = isas_cli.run(
        *("scene=kirby", "sampler=mitsuba", *SETTINGS, "budget.iterations=15"),
        *("estimator.silhouettes=direct", "estimator.batch=4096", f"hydra.run.dir={tmp_path}"),
    )
    error = run.history["parameter_rmse"]
    assert error.iloc[-1] < 0.95 * error.iloc[0]


def test_a_rate_of_100_ends_with_finite_numbers_and_says_what_happened(tmp_path):
    unknowns = "scene.unknowns={figure.vertices: {start: sphere, lr: 100}}"
    run = isas_cli.run(
        *("scene=kirby", "sampler=uniform", "estimator=silhouettes", unknowns, *SETTINGS),
        *("estimator.batch=1024", "budget.iterations=10", f"hydra.run.dir={tmp_path}"),
    )
    result = run.parameters()["figure.vertices"]
    assert np.isfinite(result).all()
    (said,) = (text for text in run.summary["warnings"] if "folded" in text)
    found = re.search(r"meshes/good_figure.vertices.\* is as of iteration (\d+)", said)
    # The last that nothing was wrong with, as both files have it.
    row = run.history[run.history["iteration"] == int(found[1])].iloc[0]
    folded = run.history["value/figure.vertices/folded"]
    assert folded[row.name] <= 0.005 < folded.iloc[-1]
    good = [trimesh.load(tmp_path / "meshes" / f"good_figure.vertices.{kind}", process=False)
            for kind in ("ply", "obj")]  # fmt: skip
    assert all(each.is_watertight and len(each.vertices) == len(result) for each in good)
    np.testing.assert_allclose(good[0].vertices, good[1].vertices, atol=1e-6)
    apart = Sampled.of(np.array(good[0].vertices), np.array(good[0].faces))
    mesh = trimesh.load(tmp_path / "meshes" / "truth_figure.vertices.ply", process=False)
    truth = Sampled.of(np.array(mesh.vertices), np.array(mesh.faces), 2)
    assert shape_error.apart(apart, truth)["chamfer"] == pytest.approx(row["parameter_rmse"], 0.02)
    # It stays where the run goes on and is never good again.
    kept = (tmp_path / "meshes" / "good_figure.vertices.ply").read_bytes()
    again = resumed(tmp_path, "budget.iterations=12")
    assert (tmp_path / "meshes" / "good_figure.vertices.ply").read_bytes() == kept
    (said,) = (text for text in again.summary["warnings"] if "folded" in text)
    assert said.endswith("meshes/good_figure.vertices.* is as it was before this run went on")


def test_what_a_shape_was_before_it_crumpled_outlives_a_kill(tmp_path, monkeypatch):
    class Killed(BaseException):
        pass

    def kill(*_) -> None:
        raise Killed

    monkeypatch.setattr(Recorder, "close", kill)
    with pytest.raises(Killed):
        isas_cli.run(
            *("scene=kirby", "sampler=uniform", "estimator=silhouettes", *SETTINGS),
            "scene.unknowns={figure.vertices: {start: sphere, lr: 100}}",
            *("estimator.batch=1024", "budget.iterations=10", f"hydra.run.dir={tmp_path}"),
        )
    good = trimesh.load(tmp_path / "meshes" / "good_figure.vertices.ply", process=False)
    assert good.is_watertight and np.ptp(good.vertices, axis=0).max() < 10


def test_samplers_that_read_moments_are_refused(tmp_path):
    with pytest.raises(InputError, match="take sampler=ours, relevant or uniform"):
        isas_cli.run("scene=kirby", "sampler=progress", f"hydra.run.dir={tmp_path}")
