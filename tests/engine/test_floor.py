"""Where a run fits its targets' noise: foretold, reached, said, and stopped at."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from problems_for_tests import built
from runs_for_tests import QUIET, ran, resumed
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli.cli.app import main
from isas_cli.config.schema import TargetConfig
from isas_cli.engine import floor
from isas_cli.engine.evaluate import Evaluator
from isas_cli.engine.loop import Loop
from isas_cli.losses import L2
from isas_cli.runtime.errors import InputError

TINY = ["scene=pottery", "size=tiny", "sampler=uniform", "effects=full", "estimator.batch=1024"]
TINY += ["evaluation.pixels=512", *QUIET]


def measured(*settings):
    made = built(*TINY, *settings)
    return made, Evaluator(made, L2(), 1024, 8, 0).floor


def test_four_times_the_paths_halve_it():
    (_, few), (_, many) = measured("target.spp=64"), measured("target.spp=256")
    for coarse, fine in (
        (few.image_rmse, many.image_rmse),
        *zip(few.parameter_rmse.values(), many.parameter_rmse.values()),
    ):
        print("quotient", coarse / fine)
        assert 1.6 < coarse / fine < 4  # strata gain more than by 1 / √n


@pytest.mark.parametrize("key", [TEXTURE, ROUGHNESS])
def test_it_is_what_a_least_squares_fit_is_left_with(key):
    """Against the fit itself: a linear problem, its matrix by differences, and targets to which
    noise is added that is known."""
    p = problem({key: 0.5}, constant_target=None)
    truth, pixels = p.unknowns[key].truth, p.views.total
    evaluator = Evaluator(p, L2(), pixels, 256, 1)
    p.variance = np.full(pixels, 0.05**2, np.float32)
    found = evaluator.floor

    def shown(array):
        (first, second) = evaluator._halves(p.unknowns.values_of({key: array}))
        return np.array((first + second) / 2, np.float64).T.reshape(-1)

    here, columns, flat = shown(truth), [], truth.reshape(-1)
    for entry in range(flat.size):
        moved = flat.copy()
        moved[entry] += 0.1
        columns.append((shown(moved.reshape(truth.shape)) - here) / 0.1)
    matrix = np.stack(columns, 1)
    seen = np.linalg.norm(matrix, axis=0) > 0
    covariance = 0.05**2 * np.linalg.pinv(matrix[:, seen].T @ matrix[:, seen])
    image = np.sqrt(np.trace(matrix[:, seen] @ covariance @ matrix[:, seen].T) / (3 * pixels))
    parameter = np.sqrt(np.trace(covariance) / seen.sum())
    print("image", found.image_rmse / image, "parameter", found.parameter_rmse[key] / parameter)
    assert found.image_rmse == pytest.approx(image, rel=0.3)
    # To first order: what neighbours share is left out, so that it is less.
    assert 0.3 * parameter < found.parameter_rmse[key] < 1.3 * parameter


def test_noise_where_an_unknown_does_not_show_is_of_no_account():
    p = problem({TEXTURE: 0.5}, constant_target=None)
    pixels, found = p.views.total, []
    hides = Evaluator(p, L2(), pixels, 16, 1).products(p.unknowns.starts()) == 0
    assert 0.1 < hides.mean() < 0.9
    for factor in (1, 100):
        p.variance = np.where(hides, factor * 0.05**2, 0.05**2).astype(np.float32)
        found.append(Evaluator(p, L2(), pixels, 16, 1).floor)
    quiet, loud = found
    assert loud.pixel_rms > 2 * quiet.pixel_rms
    assert loud.image_rmse == pytest.approx(quiet.image_rmse, rel=0.1)
    assert loud.parameter_rmse == pytest.approx(quiet.parameter_rmse, rel=0.1)


def test_no_more_is_fitted_than_there_is():
    """By a texture that is finer than the pixels that show it, whose noise is all there is."""
    p = problem({TEXTURE: 0.5}, constant_target=None, size=16)
    pixels = p.views.total
    assert p.unknowns[TEXTURE].truth.size > 3 * pixels
    evaluator = Evaluator(p, L2(), pixels, 256, 1)
    hides = evaluator.products(p.unknowns.starts()) == 0
    assert 0.1 < hides.mean() < 0.9
    p.variance = np.where(hides, 0, 0.05**2).astype(np.float32)
    found = evaluator.floor
    print(found.image_rmse / found.pixel_rms)
    assert 0.4 * found.pixel_rms < found.image_rmse <= found.pixel_rms


def test_a_bright_path_does_not_hide_what_else_shows():
    p = problem({TEXTURE: 0.5}, constant_target=None, size=16)
    p.variance = np.full(p.views.total, 0.05**2, np.float32)
    pixels, shown = np.arange(p.views.total), np.ones(p.views.total)
    shown[0] = 1e6
    found = [floor.measure(p, pixels, lambda _, s=s: s, 1) for s in (np.ones_like(shown), shown)]
    assert found[1].image_rmse == pytest.approx(found[0].image_rmse) == found[0].pixel_rms


def test_what_is_not_known_has_none():
    assert measured("target.spp=1")[1] is None
    p = problem({TEXTURE: 0.5})
    assert Evaluator(p, L2(), 64, 4, 0).floor is None
    assert measured("target.spp=2", "scene.weights=equal")[1] is None


def test_a_run_stops_there_and_says_so(tmp_path, capsys):
    """Noisy targets, so that few steps are enough."""
    settings = [*TINY, "target.spp=16", "budget.iterations=2000", "evaluation.count=100"]
    run = ran(tmp_path, *settings, "optimizer.lr=0.05", "budget.converged=true")
    floor, summary = run.manifest["targets"]["image_rmse"], run.summary
    assert summary["status"] == "done" and summary["iterations"] < 2000
    assert summary["final"]["image_rmse"] <= floor
    assert np.all(run.history.image_rmse[:-1] > floor)
    assert "what is left is the targets' noise" in summary["notes"][0]
    assert "what is left is the targets' noise" in " ".join(capsys.readouterr().err.split())
    # Killed while its pictures were made, it has ended all the same.
    (tmp_path / "summary.json").write_text(json.dumps(summary | {"complete": False}))
    assert resumed(tmp_path).summary["iterations"] == summary["iterations"]


def test_an_error_that_cannot_be_told_is_no_end(monkeypatch):
    loop = SimpleNamespace(floor=SimpleNamespace(image_rmse=0.1), last={"image_rmse": 0.0})
    for unresolved in (False, True):
        loop.unresolved = unresolved
        assert Loop.converged.fget(loop) == (not unresolved)


def test_numbers_are_moved_by_their_own_size_not_by_their_range():
    """Densities may be up to 1e4, parameters of an unknown renderer anything."""
    rng = np.random.default_rng(0)
    truth, seen = np.full(50, 2.0, np.float32), np.ones(50, bool)
    wide = SimpleNamespace(truth=truth, start=1.5 * truth, seen=seen, low=0.001, high=1e4)
    assert np.abs(floor._moved(wide, rng) - truth).max() == pytest.approx(0.1, rel=1e-3)
    narrow = SimpleNamespace(truth=truth, start=truth, seen=seen, low=1.9, high=2.5)
    assert np.abs(floor._moved(narrow, rng) - truth).max() == pytest.approx(0.03, rel=1e-3)


def test_a_map_with_a_sun_does_not_become_brighter_as_a_whole(rng):
    """A twentieth of its size is more than its dark texels have, some of them nothing."""
    truth = rng.uniform(0.2, 1.0, (16, 32, 3)).astype(np.float32)
    truth[:4], truth[8, 8] = 0.0, 1e4
    sky = SimpleNamespace(
        **dict(truth=truth, start=np.ones_like(truth), seen=np.ones(truth.shape, bool)),
        **dict(low=0.0, high=np.inf),
    )
    moved = floor._moved(sky, rng)
    assert np.all(moved != truth) and moved.min() >= 0
    assert np.mean(moved[4:] > truth[4:]) == pytest.approx(0.5, abs=0.1)
    assert moved[:4].max() < 1.0


def test_an_image_error_of_none_is_said_to_be_no_perfect_fit(tmp_path, monkeypatch):
    always = property(lambda self: True, lambda *_: None)
    monkeypatch.setattr(Evaluator, "unresolved", always, raising=False)
    settings = [*TINY, "target.spp=64", "budget.iterations=2", "evaluation.spp=2"]
    (note,) = ran(tmp_path, *settings).summary["notes"]
    assert "no perfect fit" in note and "the 2 paths a pixel of an evaluation" in note


def test_a_run_with_clean_targets_does_not(tmp_path):
    run = ran(tmp_path, *TINY, "target.spp=64", "budget.iterations=2", "budget.converged=true")
    assert run.summary["iterations"] == 2
    assert run.summary["notes"] == []
    assert set(run.manifest["targets"]) == {"noise", "pixel_rms", "image_rmse", "parameter_rmse"}


def test_the_noise_is_told_where_nothing_foretells_what_it_leaves(tmp_path):
    run = ran(tmp_path, *TINY, "target.spp=64", "budget.iterations=1", "scene.weights=equal")
    assert set(run.manifest["targets"]) == {"noise", "pixel_rms"}
    assert 0 < run.manifest["targets"]["noise"] < 1


def test_one_setting_says_how_clean_targets_are():
    assert TargetConfig().wanted == TargetConfig(noise=0.03).wanted == 0.03
    assert TargetConfig(spp=4).wanted is None
    for wrong in ({"noise": 0.1, "spp": 4}, {"noise": 0.0}, {"noise": 2.0}, {"spp": 0}):
        with pytest.raises(InputError, match="target"):
            TargetConfig(**wrong)


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["run", "target.spp=1"], ["budget.converged=true", "one path a pixel"]),
        (["run", "target.spp=2", "scene.weights=equal"], ["where views have weights"]),
        (["run", "scene=occlusion", "~scene.method"], ["'red.depth', which moves objects"]),
        (["race", "samplers=uniform,ours", "target.spp=2"], ["a race gives all the same time"]),
    ],
)
def test_where_it_cannot_stop_it_says_why(capfd, words, parts, tmp_path):
    tiny = [each for each in TINY if not each.startswith("sampler")]
    command = [words[0], *tiny, *words[1:]]
    assert main([*command, "budget.converged=true", f"hydra.run.dir={tmp_path / 'r'}"]) == 2
    said = " ".join(capfd.readouterr().err.split())
    for part in parts:
        assert part in said
