"""Scenes whose kernels Dr.Jit cannot freeze, and those that it can if it is shown their arrays."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scenes_for_tests import without_targets

from isas_cli.rendering import kernels, trial
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime.errors import InputError
from isas_cli.scene import lenses

BALL = "ball.bsdf.reflectance.value"
ALBEDO = "ball.interior_medium.albedo.value.value"
SIDE = 12


def description(**changed) -> dict:
    look = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE}
    camera = {"type": "perspective", "to_world": look, "film": film}
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 3},
        "light": {"type": "constant"},
        "ball": {"type": "sphere", "bsdf": {"type": "diffuse"}},
        "sensor": camera | changed.pop("sensor", {}),
        **changed,
    }


def smoke(**phase) -> dict:
    medium = {"type": "homogeneous", "sigma_t": 1.0, "albedo": 0.8, "phase": phase}
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium}
    return description(integrator={"type": "prbvolpath", "max_depth": 4}, ball=ball)


def panel() -> dict:
    texels = np.random.default_rng(1).random((4, 4, 3), np.float32)
    radiance = {"type": "bitmap", "bitmap": mi.Bitmap(texels), "raw": True}
    place = mi.ScalarTransform4f().translate([0, 0, 3]).rotate([0, 1, 0], 180)
    lamp = {"type": "rectangle", "to_world": place}
    return description(light=lamp | {"emitter": {"type": "area", "radiance": radiance}})


def fibres() -> dict:
    matrices = np.tile(np.float32([0.2, 0.3, 0.9, 0, 0, 0]), (2, 2, 2, 1))
    return {"type": "gridvolume", "grid": mi.VolumeGrid(matrices), "filter_type": "nearest"}


BLEND = {"weight": 0.4, "one": {"type": "isotropic"}, "other": {"type": "hg", "g": 0.3}}
FROZEN = {
    "thin lens": lambda: description(sensor={"type": "thinlens", "aperture_radius": 0.2}),
    "orthographic": lambda: description(sensor={"type": "orthographic"}),
    "textured lamp": panel,
    "hg": lambda: smoke(type="hg", g=0.5),
    "blendphase": lambda: smoke(type="blendphase", **BLEND),
}
UNFROZEN = {
    "tabphase": lambda: smoke(type="tabphase", values="0.5, 1, 1.5"),
    "sggx": lambda: smoke(type="sggx", S=fibres()),
}


def problem(described: dict):
    made = without_targets(described, {ALBEDO if "interior" in described["ball"] else BALL: 0.3})
    made.sensors = lenses.of(made.scene, range(1))
    # No literals, which would be compiled in.
    params = mi.traverse(made.scene)
    for key in params.keys():
        if key.rpartition(".")[2] in ("g", "value") and "phase_function" in key:
            value = params[key]
            params[key] = value + dr.opaque(type(value), 0)
    params.update()
    made.unknowns.write(made.unknowns.starts())
    return made


def image(made) -> np.ndarray:
    """Of a few paths a pixel, by fixed random numbers, twice: recorded, and run from that."""
    renderer = Renderer(made)
    found = [renderer.range(0, made.views.total, 4, lambda sample: sample) for _ in range(2)]
    assert np.array_equal(*found)
    return found[0]


@pytest.mark.parametrize("name", FROZEN)
def test_what_can_be_frozen_is(name, fixed_order):
    made = problem(FROZEN[name]())
    trial.look(made, "here")
    assert made.freezes and not made.warnings
    assert np.array_equal(image(made), image(replace(made, freezes=False)))


@pytest.mark.parametrize("name", UNFROZEN)
def test_what_cannot_be_frozen_runs_all_the_same_and_says_so_once(name, fixed_order):
    made = problem(UNFROZEN[name]())
    trial.look(made, "here")
    assert not made.freezes
    assert len(made.warnings) == 1 and "cannot be frozen" in made.warnings[0]
    # The attempt leaves nothing behind: a scene that nobody tried to freeze shows the same.
    untouched = replace(problem(UNFROZEN[name]()), freezes=False)
    assert np.array_equal(image(made), image(untouched))
    key = made.unknowns.keys[0]
    assert np.array_equal(np.array(made.unknowns.leaves[key]).ravel()[0], np.float32(0.3))


def test_a_kernel_that_cannot_be_frozen_adds_its_gradient_once():
    made = problem(UNFROZEN["tabphase"]())
    trial.look(made, "here")
    found = []
    for tried in (made, replace(problem(UNFROZEN["tabphase"]()), freezes=False)):
        run = trial.Pass(tried, tried.views.total)
        tried.unknowns.attach(tried.unknowns.starts())
        run(0, 1.0, 3, False)
        found.append(np.array(next(iter(tried.unknowns.gradients().values()))))
    assert np.allclose(*found, rtol=1e-4) and np.all(found[0] > 0)


def test_a_scene_that_mitsuba_cannot_trace_is_refused(monkeypatch):
    made = problem(description())

    def broken(*arguments):
        raise RuntimeError("not permitted\nand more")

    monkeypatch.setattr(made.integrator, "backward", broken)
    with pytest.raises(InputError, match="here: Mitsuba cannot trace .*: not permitted$"):
        trial.look(made, "here")


@pytest.mark.parametrize("frozen", [False, True])
def test_a_full_memory_is_no_fault_of_the_scenes(monkeypatch, frozen):
    made = problem(description())

    def traced(tried, differentiated):
        def run():
            if tried.freezes == frozen:
                raise RuntimeError("jit_malloc(): out of memory!")

        return run

    monkeypatch.setattr(trial, "_traced", traced)
    with pytest.raises(RuntimeError, match="out of memory"):
        trial.look(made, "here")
    assert made.freezes and not made.warnings


def test_hidden_arrays_are_those_of_phase_functions():
    made = problem(FROZEN["blendphase"]())
    assert len(kernels.hidden(made.scene)()) == 2
    assert kernels.hidden(problem(description()).scene)() == []
