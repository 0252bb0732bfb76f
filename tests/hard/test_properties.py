"""What holds of any numbers: distributions, losses, steps, sentences."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli.config.compose import compose, translate
from isas_cli.config.grammar import override
from isas_cli.config.schema import OptimizerConfig
from isas_cli.engine.optimiser import Stepper
from isas_cli.losses import L1, L2, RelativeL2
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime.errors import InputError
from isas_cli.scene.views import Views
from isas_cli.unknowns.parameters import as_numpy, unflat

# The same examples every time: a failure here is one everywhere.
fixed = settings(max_examples=25, deadline=None, derandomize=True, database=None)

WEIGHTS = st.one_of(
    st.just(0.0),
    st.sampled_from([math.nan, math.inf, -1.0, 1e-45]),
    st.floats(-30, 30).map(lambda power: 10.0**power),
)
SIZES = st.lists(st.tuples(st.integers(1, 9), st.integers(1, 9)), min_size=1, max_size=4)


@fixed
@given(SIZES, st.data(), st.sampled_from([0.0, 1e-6, 0.1, 1.0]), st.sampled_from([1, 7, 1 << 20]))
def test_a_pmf_sums_to_one_and_is_what_is_drawn(sizes, data, floor, most):
    """Of weights from 1e-30 to 1e30, zeros and what is no weight; views of any sizes."""
    tiles = Tiles.over(Views.of(sizes), most=most)
    weights = data.draw(st.lists(WEIGHTS, min_size=tiles.count, max_size=tiles.count))
    found = PixelDistribution.from_weights(mi.Float(weights), tiles, floor)
    views = tiles.views
    p = np.array(found.probability(*views.locate(dr.arange(mi.UInt32, views.total))), np.float64)
    assert np.all(p >= 0) and p.sum() == pytest.approx(1, abs=1e-5)
    assert np.all(p >= floor / views.total * (1 - 1e-5))
    view, column, row, drawn = found.draw(64, mi.UInt32(3))
    at = [np.array(each).astype(int) + np.zeros(64, int) for each in (view, column, row)]
    for index in range(64):
        width, height = sizes[at[0][index]]
        assert 0 <= at[1][index] < width and 0 <= at[2][index] < height
    drawn = np.array(drawn) + np.zeros(64)
    assert np.all(drawn > 0) and np.all(np.isfinite(1 / drawn))
    pixel = np.array(views.index(mi.UInt32(at[0]), mi.UInt32(at[1]), mi.UInt32(at[2])))
    assert np.array_equal(drawn.astype(np.float32), p[pixel].astype(np.float32))


RADIANCES = st.lists(
    st.one_of(st.just(0.0), st.floats(-12, 12).map(lambda power: 10.0**power)),
    min_size=3,
    max_size=3,
)


@pytest.mark.parametrize("loss", [L1(), L2(), RelativeL2()], ids=lambda loss: type(loss).__name__)
def test_a_loss_is_least_at_its_target(loss):
    """Radiances from 0 to 1e12, black targets among them: all finite, derivatives uphill."""

    @fixed
    @given(RADIANCES, RADIANCES)
    def holds(image, target):
        i, t = mi.Color3f(image), mi.Color3f(target)
        value, derivative, curvature = (
            np.array(each, np.float64).ravel() + np.zeros(3)
            for each in (loss.value(i, t), loss.derivative(i, t), loss.curvature(t))
        )
        assert np.isfinite([value, derivative, curvature]).all()
        assert np.all(value >= 0) and np.all(curvature >= 0)
        single = np.float32(image) - np.float32(target)
        assert np.all(derivative * single >= 0)
        assert np.all((derivative == 0) == (single == 0))

    holds()


@pytest.fixture(scope="module")
def unknowns():
    return problem({TEXTURE: 0.5, ROUGHNESS: 0.5}).unknowns


ENTRIES = st.one_of(
    st.sampled_from([0.0, math.nan, math.inf, -math.inf]),
    st.builds(lambda sign, power: sign * 10.0**power, st.sampled_from([-1, 1]), st.floats(-40, 38)),
)


def test_a_step_keeps_every_value_finite_and_legal(unknowns):
    """Whatever the gradient and however long the step; what cannot be used is counted, and an entry
    that met such a gradient goes on afterwards."""

    @fixed
    @given(st.lists(ENTRIES, min_size=4, max_size=4), st.sampled_from([1e-12, 0.02, 1.0, 1e6]))
    def holds(entries, rate):
        stepper = Stepper(unknowns, OptimizerConfig(lr=rate, schedule="constant"))
        texture = stepper.values[TEXTURE]
        size = math.prod(texture.shape)

        def gradients(values) -> dict:
            number = unflat(stepper.values[ROUGHNESS], mi.Float(float(values[0])))
            return {TEXTURE: unflat(texture, mi.Float(np.resize(values, size))), ROUGHNESS: number}

        with np.errstate(over="ignore"):
            given_ = np.float32(entries)
        for _ in range(2):
            stepper.step(gradients(given_), 0.0)
        assert all(np.isfinite(array).all() for array in stepper.export()[0].values())
        first = as_numpy(stepper.values[TEXTURE]).ravel()
        assert np.isfinite(first).all() and first.min() >= 0 and first.max() <= 1
        unusable = ~(np.abs(np.resize(given_, size)) < 1e18)
        assert sum(stepper.lost.values()) == 2 * (unusable.sum() + int(unusable[0]))
        assert np.all(first[unusable] == 0.5)
        for _ in range(3):
            stepper.step(gradients(np.ones(1, np.float32)), 0.0)
        moved = as_numpy(stepper.values[TEXTURE]).ravel()
        assert np.isfinite(moved).all()
        if rate == 0.02:
            assert np.all(moved[unusable] < 0.5)

    holds()


@settings(fixed, max_examples=8)  # each is composed
@given(
    st.text(max_size=40), st.sampled_from(["name", "scene.path", "optimizer.lr", "sampler", "x"])
)
def test_what_is_typed_is_taken_or_refused(text, key):
    try:
        compose(translate([f"scene={'file' if key == 'scene.path' else 'sort'}", f"{key}={text}"]))
    except InputError as error:
        assert "\n" not in str(error)


@fixed
@given(
    st.recursive(
        st.one_of(st.integers(-(10**9), 10**9), st.booleans(), st.text(max_size=12), st.none()),
        lambda inner: st.lists(inner, max_size=3),
        max_leaves=6,
    )
)
def test_values_survive_being_written_as_overrides(value):
    """Quotes, backslashes, commas and braces among them."""
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parsed = OverridesParser.create().parse_override(f"key={override(value)}")
    assert parsed.value() == value
