"""Mitsuba's own derivatives of what moves, plain and blurred: against quadrature, differences."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest
import trimesh
from blurred_gradients import BATCH, LEVEL, made, p_value, references_of, rows, unbiased
from mitsuba.python.ad.integrators.common import ADIntegrator
from poses_for_tests import AT, COLOUR, PLACE, blurred_problem, description
from scenes_for_tests import render_targets, without_targets
from scipy import stats

import isas_cli
from isas_cli import losses
from isas_cli.config.schema import BlurConfig, PoseConfig, UnknownConfig
from isas_cli.estimators.finite_differences import FiniteDifferences
from isas_cli.estimators.mitsuba import WholeImages
from isas_cli.rendering import convex
from isas_cli.runtime.errors import InputError

COUNT = 1500  # of estimates


@pytest.mark.slow  # 1,500 steps of projective integrators, which are never frozen
@pytest.mark.parametrize("smooth", ("image", "loss"))
def test_mitsubas_derivative_blurred(smooth):
    """κ∂P, by prb_projective, of a ball that glows: no silhouette is seen by way of others, which
    would take seconds a step."""
    p = blurred_problem(glows=True)
    # The offsets make the noise, not the paths: many estimates.
    found = rows(WholeImages(p, losses.L2(), 2 * BATCH, smooth, silhouettes="direct"), p, COUNT)
    assert unbiased(found, references_of(p)[smooth], seen=0.6)


@pytest.mark.slow
def test_mitsubas_own_derivative():
    """Unblurred, of place and radiance, against differences over so small a step that they change
    no more: the mean image is smooth in both."""
    p = blurred_problem(glows=True)
    found = rows(WholeImages(p, losses.L2(), 2 * BATCH, silhouettes="direct"), p, 100)
    exact = rows(FiniteDifferences(p, losses.L2(), 64 * BATCH, 0.01), p, 60)
    assert unbiased(found, exact)
    assert np.all(np.abs(exact.mean(axis=0)) > 5 * exact.std(axis=0) / math.sqrt(len(exact)))


@pytest.mark.parametrize("blind", (True, "last"))
def test_mitsubas_derivative_of_all_views(blind):
    """Before or after a camera that looks away: the other's gradient arrives."""
    p = blurred_problem(glows=True, blind=blind)
    found = rows(WholeImages(p, losses.L2(), 4 * BATCH, silhouettes="direct"), p, 4)
    assert np.all(np.abs(found.mean(axis=0)) > 1e-4)


@pytest.mark.slow
def test_kernel_and_renderer_agree_at_the_end_of_a_range():
    """The radiance near 1, where it is clamped."""
    p = blurred_problem(at=(AT[0], 0.9), widths=(0.05, 0.3), glows=True)
    by_kernel = rows(made(p, smooth="loss", scheme="separate"), p, 600)
    by_renderer = rows(WholeImages(p, losses.L2(), 2 * BATCH, "loss", silhouettes="direct"), p, 200)
    test = stats.ttest_ind(by_kernel[:, 1], by_renderer[:, 1], equal_var=False)
    print(by_kernel.mean(axis=0), by_renderer.mean(axis=0), test.pvalue)
    assert test.pvalue > LEVEL


@pytest.mark.parametrize("smooth", (None, "image"))
@pytest.mark.parametrize("moved", ("bulb", "spot", "sensor_000"))
def test_what_is_no_shape_cannot_be_moved_by_mitsubas_derivative(moved, smooth):
    lights = {
        "bulb": {"type": "point", "position": [0.0, 1.0, 2.0]},
        "spot": {"type": "spot", "to_world": mi.ScalarTransform4f().translate([0, 1, 2])},
    }
    poses = {"x": PoseConfig(kind="translation", objects=[moved], directions=[[1, 0, 0]])}
    unknowns = {"x": UnknownConfig(start=0.5, blur=BlurConfig(start=0.2, end=0.1))}
    p = without_targets(description() | lights, unknowns, poses)
    with pytest.raises(InputError, match=f"'x'. moves '{moved}', which is no shape") as refused:
        WholeImages(p, losses.L2(), BATCH, smooth)
    assert "\n" not in str(refused.value)


def count_paths(monkeypatch) -> list[int]:
    """How many of Mitsuba's samples of images, derivatives and silhouettes are begun from now on,
    a number for each launch."""
    prepare, traced = ADIntegrator.prepare, []

    def counted(self, *given, **named):
        sampler, spp = prepare(self, *given, **named)
        traced.append(sampler.wavefront_size())
        return sampler, spp

    monkeypatch.setattr(ADIntegrator, "prepare", counted)
    return traced


@pytest.mark.parametrize("smooth", (None, "image", "loss"))
def test_paths_are_counted_as_they_are_traced(smooth, monkeypatch):
    p, traced = blurred_problem(glows=True), count_paths(monkeypatch)
    estimator = WholeImages(p, losses.L2(), 2 * BATCH, smooth, silhouettes="direct")
    rows(estimator, p, 1)
    assert sum(traced) == estimator.paths_per_step


def test_silhouettes_by_way_of_others_are_counted_too(monkeypatch):
    p, traced = under_a_sky(others=("wall",)), count_paths(monkeypatch)
    render_targets(p, 1)
    estimator = WholeImages(p, losses.L2(), 2 * BATCH)
    traced.clear()
    rows(estimator, p, 1)
    assert sum(traced) == estimator.paths_per_step == 4 * estimator.spp * p.views.total


def test_a_scenes_sampler_makes_no_more_paths(monkeypatch):
    """A stratified one has squares of numbers alone."""
    scene = description()
    scene["sensor_000"] |= {"sampler": {"type": "stratified", "sample_count": 4}}
    p = without_targets(scene, {COLOUR: 0.5})
    render_targets(p, 16)
    traced = count_paths(monkeypatch)
    estimator = WholeImages(p, losses.L2(), 3 * p.views.total)
    rows(estimator, p, 1)
    assert sum(traced) == estimator.paths_per_step == 2 * 3 * p.views.total


def test_mitsuba_prints_nothing_on_standard_output(capfd):
    p = blurred_problem(glows=True)
    rows(WholeImages(p, losses.L2(), 2 * BATCH, silhouettes="direct"), p, 1)
    assert capfd.readouterr().out == ""


def test_mitsubas_own_derivative_does_not_see_over_a_plateau():
    """The ball outside the view: no derivative, while the blurred objective has a slope. (Upwards:
    a ball that comes into view at a wrong place is worse than none.)"""
    p = blurred_problem(at=(-2.6, AT[1]), widths=(0.8, 0.1), glows=True)
    stock = rows(WholeImages(p, losses.L2(), BATCH, silhouettes="direct"), p, 8)
    plateau = rows(made(p, smooth="loss"), p, 800)
    assert np.abs(stock[:, 0]).max() < 1e-6
    mean, error = plateau[:, 0].mean(), plateau[:, 0].std() / math.sqrt(len(plateau))
    print("slope", mean, "±", error)
    assert mean > 4 * error


def under_a_sky(ball: dict | None = None, others=(), **unknowns):
    """The ball alone, or what is given for it, but for ``others`` of the description."""
    scene = description()
    for name in {"wall", "lamp"} - set(others):
        del scene[name]
    scene["ball"] = ball or scene["ball"]
    unknowns = unknowns or {PLACE: AT[0], COLOUR: AT[1]}
    pose = PoseConfig(kind="translation", objects=["ball"], directions=[[1, 0, 0]], at=[0.2])
    return without_targets(scene, unknowns, {PLACE: pose} if PLACE in unknowns else None)


@pytest.mark.parametrize(("others", "lost"), (((), False), (("wall",), True)))
def test_what_is_convex_and_alone_has_no_silhouettes_by_way_of_others(monkeypatch, others, lost):
    """Nothing is lost there: the same gradient, step by step. Beside a wall it is another one."""
    p = under_a_sky(others=others)
    render_targets(p, 64)
    assert convex.alone(p) is not lost
    found = []
    for answer in (True, False):
        monkeypatch.setattr(convex, "alone", lambda problem, answer=answer: answer)
        found.append(rows(WholeImages(p, losses.L2(), 4 * BATCH), p, 3))
    assert np.abs(found[0]).min() > 1e-5
    assert np.allclose(*found, rtol=1e-3) is not lost


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    """Files of a convex mesh, a ring, two convex ones in one file, two that touch, and half of
    one."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    cube = trimesh.creation.box()
    half = ball.copy()
    half.update_faces(half.triangles_center[:, 2] > 0)
    made = {
        "ball": ball,
        "ring": trimesh.creation.torus(1.0, 0.3, 16, 8),
        "two": trimesh.util.concatenate([ball, ball.copy().apply_translation([3, 0, 0])]),
        "touching": trimesh.util.concatenate([cube, cube.copy().apply_translation([1, 1, 1])]),
        "half": half,
    }
    folder = tmp_path_factory.mktemp("bodies")
    for name, mesh in made.items():
        mesh.export(folder / f"{name}.ply")
    return folder


@pytest.mark.parametrize("name", ("ball", "ring", "two", "touching", "half"))
def test_meshes_are_asked_whether_they_are_convex(bodies, name):
    mesh = {"type": "ply", "filename": str(bodies / f"{name}.ply")}
    assert convex.alone(under_a_sky(mesh, **{PLACE: 0.0})) is (name == "ball")


@pytest.mark.parametrize("shape", ("cube", "rectangle", "disk", "cylinder"))
def test_shapes_that_are_convex_by_their_name(shape):
    found = {"type": shape, "bsdf": description()["ball"]["bsdf"]}
    assert convex.alone(under_a_sky(found, **{COLOUR: 0.5})) is (shape != "cylinder")


def test_a_convex_mesh_whose_vertices_are_unknown_may_not_stay_so(bodies):
    mesh = {"type": "ply", "filename": str(bodies / "ball.ply")}
    vertices = {"ball.vertices": UnknownConfig(start="sphere")}
    assert not convex.alone(under_a_sky(mesh, **vertices))


@pytest.mark.slow
def test_the_edge_of_a_point_lights_shadow_is_missing():
    """A limit of Mitsuba's, which the baseline on `shadows` has: no traced ray meets the light."""
    p = blurred_problem(at=(0.0, AT[1]), point=True)
    found = rows(WholeImages(p, losses.L2(), 16 * BATCH, silhouettes="uniform"), p, 150)
    exact = rows(FiniteDifferences(p, losses.L2(), 64 * BATCH, 0.05), p, 100)
    assert p_value(found, exact) < LEVEL


def test_a_medium_that_only_emits_is_none_of_mitsubas(tmp_path):
    settings = "scene=lego", "size=tiny", "sampler=mitsuba", "target.spp=1"
    with pytest.raises(InputError, match="take estimator=two_path"):
        isas_cli.run(*settings, f"hydra.run.dir={tmp_path}")
