"""The prior of materials: value and gradient in closed form, each term by itself."""

import mitsuba as mi
import numpy as np
import pytest
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli.losses.materials import Materials, OnMaterials
from isas_cli.losses.priors import Nothing, Smoothness
from isas_cli.runtime.errors import InputError

METAL = "thing.bsdf.metallic.value"


def values(rng) -> dict:
    shapes = {TEXTURE: (4, 5, 3), ROUGHNESS: (1,), METAL: (6,)}
    return {key: mi.TensorXf(rng.random(s).astype(np.float32)) for key, s in shapes.items()}


def test_each_term_is_its_formula_and_can_be_left_out(rng):
    at = values(rng)
    zero = {key: value * 0 for key, value in at.items()}
    rough, metal = (np.array(at[key], np.float64) for key in (ROUGHNESS, METAL))
    parts = {
        "metallic": (np.mean(metal * (1 - metal)), {METAL: (1 - 2 * metal) / metal.size}),
        "roughness": (np.mean((rough - 0.3) ** 2), {ROUGHNESS: 2 * (rough - 0.3)}),
    }
    for name, (value, slopes) in parts.items():
        off = {"smooth": 0.0, "metallic": 0.0, "roughness": 0.0, name: 2.0}
        made = OnMaterials(
            Materials(**off, expected=0.3), None, [METAL], [ROUGHNESS], dict.fromkeys(at, 1.0)
        )
        assert made.value(at) == pytest.approx(2 * value, rel=1e-5)
        found = made.add(at, zero)
        for key in at:
            wanted = 2 * slopes[key] if key in slopes else 0.0
            assert np.allclose(np.array(found[key]), wanted, atol=1e-6), key


def test_on_a_problem_the_smooth_part_is_smoothness(rng):
    unknowns = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}).unknowns
    at = unknowns.starts()
    at[TEXTURE] = type(at[TEXTURE])(rng.random(at[TEXTURE].shape).astype(np.float32))
    zero = {key: value * 0 for key, value in at.items()}
    made = Materials(smooth=0.7, roughness=0.5, expected=0.2).on(unknowns)
    plain = Smoothness(0.7).on(unknowns)
    assert made.value(at) == pytest.approx(plain.value(at) + 0.5 * 0.3**2, rel=1e-5)
    found, alone = made.add(at, zero), plain.add(at, zero)
    assert np.array_equal(np.array(found[TEXTURE]), np.array(alone[TEXTURE]))
    assert np.allclose(np.array(found[ROUGHNESS]), 0.5 * 2 * 0.3)
    unknowns[TEXTURE].prior, unknowns[ROUGHNESS].prior = 3.0, 0.5
    own = Materials(smooth=0.7, roughness=0.5, expected=0.2).on(unknowns)
    assert own.value(at) == pytest.approx(3 * plain.value(at) + 0.5 * 0.5 * 0.3**2, rel=1e-5)
    found = own.add(at, zero)
    assert np.allclose(np.array(found[TEXTURE]), 3 * np.array(alone[TEXTURE]))
    assert np.allclose(np.array(found[ROUGHNESS]), 0.5 * 0.5 * 2 * 0.3)


def test_what_no_view_sees_is_not_moved(rng):
    unknowns = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}).unknowns
    at = unknowns.starts()
    at[TEXTURE] = type(at[TEXTURE])(rng.random(at[TEXTURE].shape).astype(np.float32))
    zero = {key: value * 0 for key, value in at.items()}
    for unknown in unknowns:
        unknown.unseen = True
    made = Materials(smooth=0.7, roughness=0.5, expected=0.2).on(unknowns)
    assert made.value(at) == 0
    assert not any(np.array(each).any() for each in made.add(at, zero).values())


def test_settings_that_no_unknown_follows_are_said():
    unknowns = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}).unknowns
    assert not Materials(smooth=0.7, roughness=0.5, expected=0.2, metallic=0).on(unknowns).unheeded
    (only,) = Materials(metallic=0.3).on(unknowns).unheeded
    assert only == "prior.metallic=0.3 has no effect: no unknown is a material's metallic"
    rest = Materials(roughness=0.3, expected=0.2).on(problem({TEXTURE: 0.5}).unknowns).unheeded
    assert [said.split("=")[0] for said in rest] == ["prior.roughness", "prior.expected"]


def test_a_texture_is_what_reads_it_whatever_it_is_called():
    """One of opacities that is called alpha is no roughness."""
    unknowns = problem({ROUGHNESS: 0.5, TEXTURE: 0.5}).unknowns
    assert [term[0] for term in Materials(smooth=0).on(unknowns).terms] == [ROUGHNESS]
    unknowns[ROUGHNESS].kind.words = frozenset({"opacity"})
    assert Materials(smooth=0).on(unknowns).terms == []
    unknowns[ROUGHNESS].kind.words = frozenset({"alpha_u"})
    assert [term[0] for term in Materials(smooth=0).on(unknowns).terms] == [ROUGHNESS]


def test_factors_on_what_has_no_prior_are_refused():
    unknowns = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}).unknowns
    unknowns[ROUGHNESS].prior = 2.0
    assert Materials().on(unknowns)
    for prior in (Nothing(), Smoothness()):
        with pytest.raises(InputError, match=f"{ROUGHNESS}'.*prior=2: the prior has no part"):
            prior.on(unknowns)


def test_what_makes_no_sense_is_refused():
    with pytest.raises(InputError, match="prior.smooth=-1"):
        Materials(smooth=-1)
    with pytest.raises(InputError, match="prior.expected=2"):
        Materials(expected=2)
