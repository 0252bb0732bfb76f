"""Settings of every sampler that ``configs/`` offers: each has an effect or is refused, and
whatever they are and stage 1 finds, what comes out is a pmf that reaches every pixel."""

import dataclasses
import types

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from crosses import crossed
from gradient_estimates import Gradients, configured, shared_settings
from hard_scenes import assemble
from samplers_for_tests import pixel_samplers
from scenes_for_tests import dictionary

from isas_cli import losses
from isas_cli.config.compose import compose, instantiate
from isas_cli.rendering.integrators import Unrolled
from isas_cli.runtime.errors import InputError
from isas_cli.samplers.sampler import OnImages
from isas_cli.scene.problem import Problem

BATCH = 512
# Another value for each of the settings that samplers share.
OTHER = {
    "floor": 0.4,
    "refresh": 7,
    "stage1.resolution": 5,
    "stage1.spp": 3,
    "stage1.probes": 3,
    "stage1.denoise": "high",
    "stage1.average": 0.9,
}
# Those that only say what is made of looks.
AFTERWARDS = ("floor", "refresh", "stage1.average")
NAMES = pixel_samplers()


def used(name: str, setting: str) -> bool:
    return setting.rpartition(".")[2] in shared_settings(name)[1]


PAIRS = [(name, setting) for name in NAMES for setting in OTHER]


FLOOR, WALL = "floor.bsdf.reflectance.data", "wall.bsdf.reflectance.value"
START = {FLOOR: 0.5, WALL: 0.5}


def plain(depth: int = 2) -> dict:
    """The tests' scene with materials and light that compile fast."""
    scene = dictionary(size=2, depth=depth, resolution=(24, 16))
    picture = scene["floor"]["bsdf"]["base_color"]
    scene["floor"]["bsdf"] = {"type": "diffuse", "reflectance": picture}
    scene["wall"]["bsdf"] = {"type": "diffuse", "reflectance": 0.4}
    del scene["lamp"]
    return scene


@pytest.fixture(scope="module")
def bench() -> Gradients:
    return Gradients(assemble(plain(), START), losses.L2(), BATCH)


def looks(sampler: OnImages, bench: Gradients) -> list[mi.Float]:
    """Cells' weights found at a run's start and later, with the random numbers of these times."""
    moments = bench.moments()
    found = [sampler.look(bench.values, 5, i, moments if i else None) for i in (0, 100)]
    bench.problem.unknowns.write(bench.values)
    return found


def probabilities(distribution) -> np.ndarray:
    """p_j of all pixels, as images are stored."""
    views = distribution.tiles.views
    pixels = views.locate(dr.arange(mi.UInt32, views.total))
    return np.array(distribution.probability(*pixels), np.float64)


def check(sampler, weights: mi.Float) -> np.ndarray:
    """That the weights make a pmf of which every pixel has its share, and give p_j n."""
    distribution = sampler.distribution(weights)
    p, count = probabilities(distribution), sampler.problem.views.total
    assert np.all(np.isfinite(p))
    assert p.sum() == pytest.approx(1, abs=1e-6)
    own = sampler.settings
    floor = own.floor if "floor" in own.uses or hasattr(own, "base") else 1.0
    assert np.all(p >= floor / count * (1 - 1e-6))
    view, column, row, probability = distribution.draw(BATCH, dr.opaque(mi.UInt32, 1))
    pixel = np.array(sampler.problem.views.index(view, column, row))
    assert pixel.max() < count and np.allclose(p[pixel], np.array(probability), rtol=1e-5)
    return p * count


def effects(sampler: OnImages, found: list[mi.Float]) -> dict[str, np.ndarray]:
    """All that a run sees of a sampler with such looks: when it looks, and the pmf after one look
    and after two."""
    first, second = found
    check(sampler, first)
    blended = sampler.blended(first, second)
    return {
        "due": np.array([sampler.settings.due(i) for i in range(200)]),
        "first": probabilities(sampler.distribution(first)),
        "second": probabilities(sampler.distribution(blended)),
    }


def check_all(sampler, bench: Gradients, freeze: bool = True) -> None:
    """Two looks, and their mean."""
    at_work = bench.prepared(sampler, freeze)
    first, second = looks(at_work, bench)
    object.__setattr__(sampler.stage1, "average", 0.5)  # frozen: asked about one number alone
    for weights in (first, second, at_work.blended(first, second)):
        check(at_work, weights)


def differ(a: dict, b: dict) -> bool:
    return any(not np.allclose(a[key], b[key], rtol=1e-3, atol=0) for key in a)


@pytest.fixture(scope="module")
def seen(bench):
    """What each sampler's looks find as configured, asked for by name."""
    return {name: looks(bench.prepared(configured("sampler", name)), bench) for name in NAMES}


@pytest.fixture(scope="module")
def usual(bench, seen):
    """Each sampler's effects as configured, asked for by name."""
    return {
        name: effects(bench.prepared(configured("sampler", name)), seen[name]) for name in NAMES
    }


def test_the_same_settings_have_the_same_effects(bench, usual):
    """Otherwise a difference would say nothing about a setting."""
    for name in NAMES:
        again = bench.prepared(configured("sampler", name))
        assert not differ(effects(again, looks(again, bench)), usual[name])


@pytest.mark.parametrize("name, setting", [pair for pair in PAIRS if used(*pair)])
def test_settings_have_an_effect(name, setting, bench, seen, usual):
    changed = configured("sampler", name, {shared_settings(name)[0] + setting: OTHER[setting]})
    changed = bench.prepared(changed)
    found = seen[name] if setting in AFTERWARDS else looks(changed, bench)
    assert differ(effects(changed, found), usual[name])


@pytest.mark.parametrize("name, setting", [pair for pair in PAIRS if not used(*pair)])
def test_settings_of_no_use_are_refused(name, setting):
    """By the configuration, and by the class itself, in one line that names the setting."""
    prefix = shared_settings(name)[0]
    owner = configured("sampler", name)
    owner = owner.base if prefix else owner
    with pytest.raises(InputError, match=setting) as refused:
        override = f"sampler.{prefix}{setting}={OTHER[setting]}"
        chosen = compose(["scene=pottery", f"sampler={name}", override])
        instantiate(chosen.sampler, "sampler")
    assert "\n" not in str(refused.value)
    where, _, last = setting.rpartition(".")
    value = dataclasses.replace(owner.stage1, **{last: OTHER[setting]}) if where else OTHER[setting]
    with pytest.raises(InputError, match=f"sampler.{setting}=") as refused:
        dataclasses.replace(owner, **{where or last: value})
    assert "\n" not in str(refused.value)


def own_settings() -> list[tuple[str, str]]:
    """Settings that only one sampler has, found on its dataclass."""
    shared = {"floor", "refresh", "stage1", "base"}
    return [
        (name, field.name)
        for name in NAMES
        for field in dataclasses.fields(configured("sampler", name))
        if field.name not in shared
    ]


@pytest.mark.parametrize("name, setting", own_settings())
def test_own_settings_have_an_effect(name, setting, bench, usual):
    """Both far smaller and far larger values are tried, as one may be out of range."""
    value = getattr(configured("sampler", name), setting)
    assert isinstance(value, int | float) and not isinstance(value, bool), "say how to change it"
    others = [1e6 * value, 1e-3 * value] if isinstance(value, float) else [value + 3, value - 2]
    for other in others:
        try:
            changed = bench.prepared(configured("sampler", name, {setting: other}))
        except InputError as error:
            assert setting in str(error) and "\n" not in str(error)
            continue
        if differ(effects(changed, looks(changed, bench)), usual[name]):
            return
    pytest.fail(f"neither of {others} differs from {value}")


@pytest.mark.parametrize("name", [name for name in NAMES if used(name, "floor")])
def test_every_pixel_keeps_the_floor(name, bench, seen):
    """Cells as small as pixels, and larger ones; films of two sizes."""
    small = bench.prepared(configured("sampler", name))
    prefix, _ = shared_settings(name)
    large = bench.prepared(configured("sampler", name, {prefix + "stage1.resolution": 5}))
    for sampler, found in ((small, seen[name]), (large, looks(large, bench))):
        for floor in (0.0, 0.05, 0.7, 1.0):
            object.__setattr__(sampler.settings, "floor", floor)  # frozen, as in check_all
            density = check(sampler, found[1])
            # Little where coarse cells are summed over coarser ones still.
            assert np.ptp(density) >= 0.01 * (1 - floor)
        assert np.allclose(density, 1, rtol=1e-6)


def dark() -> Problem:
    """No light, black targets: every residual and every derivative is zero."""
    scene = plain()
    scene["sky"]["radiance"] = 0.0
    return assemble(scene, START)


def solved() -> Problem:
    """Every pixel shows its target without noise, while the derivatives are not zero."""
    scene = plain(depth=1)
    for name in ("floor", "wall"):  # out of sight
        scene[name]["to_world"] = mi.ScalarTransform4f().translate([0, 0, 50])
    p = assemble(scene, {"sky.radiance.value": 0.5})
    p.set_targets(dr.full(mi.Float, 0.5, 3 * p.views.total), None, "test")
    return p


def unseen(others: dict) -> Problem:
    """An unknown within a closed box; ``others``: unknowns that are seen."""
    place = mi.ScalarTransform4f().translate([0, -3, 0])
    scene = plain() | {
        "box": {"type": "cube", "to_world": place.scale(0.5)},
        "hidden": {
            "type": "sphere",
            "to_world": place.scale(0.2),
            "bsdf": {"type": "diffuse", "reflectance": 0.3},
        },
    }
    return assemble(scene, others | {"hidden.bsdf.reflectance.value": 0.5})


def aimed_at(targets) -> Problem:
    """``targets``: number of an entry → its value."""
    p = assemble(plain(), START)
    index = np.arange(3 * p.views.total)
    p.set_targets(mi.Float(targets(index).astype(np.float32)), None, "test")
    return p


EXTREMES = {
    "dark": dark,
    "solved": solved,
    "nothing seen": lambda: unseen({}),
    "one unseen": lambda: unseen({FLOOR: 0.5}),
    "huge targets": lambda: aimed_at(lambda i: 1e25 + 0 * i),
    "some NaN in the targets": lambda: aimed_at(lambda i: np.where(i % 7 == 0, np.nan, 0.3)),
}


@pytest.fixture(scope="module")
def extreme(request) -> Gradients:
    made = Gradients(EXTREMES[request.param](), losses.L2(), BATCH)
    made.moments()
    return made


@pytest.mark.parametrize("extreme, name", crossed([*EXTREMES], NAMES, 3), indirect=["extreme"])
def test_extreme_problems_leave_a_pmf(name, extreme):
    check_all(configured("sampler", name), extreme)


@pytest.mark.parametrize("name, every", crossed(NAMES, [1, 5], 1))
def test_paths_of_stage_1_that_are_not_finite_leave_a_pmf(name, every, bench, monkeypatch):
    """NaN and infinities in the radiances and in the derivatives of both directions."""
    bench.moments()

    def spoil(colours: mi.Color3f) -> mi.Color3f:
        lane = dr.arange(mi.UInt32, dr.width(colours))
        spoilt = lane % dr.opaque(mi.UInt32, every) == 0
        bad = dr.select(lane % 2 == 0, mi.Float(np.nan), mi.Float(np.inf))
        return dr.select(spoilt, bad, colours)

    primal, forward, backward = Unrolled.primal, Unrolled.forward, Unrolled.backward
    monkeypatch.setattr(Unrolled, "forward", lambda *args: spoil(forward(*args)))
    monkeypatch.setattr(Unrolled, "backward", lambda *args: backward(*args[:-1], spoil(args[-1])))

    def spoilt_primal(*args):
        radiance, state = primal(*args)
        return spoil(radiance), state

    monkeypatch.setattr(Unrolled, "primal", spoilt_primal)
    # Recorded kernels would keep the arrays that spoil them.
    check_all(configured("sampler", name), bench, freeze=False)


@pytest.mark.parametrize(
    "name, views, side",
    [
        ("relevant", 16, 128),
        ("relevant", 64, 64),
        ("balanced", 64, 64),
        ("balanced", 5000, 32),
        ("progress", 1, 512),
        ("progress", 16, 128),
        ("ours", 16, 64),
    ],
)
def test_a_look_at_many_views_takes_no_more_cells_than_at_few(name, views, side):
    """Cells along a view's longer side by default, at the default batch, and as configured."""
    films = types.SimpleNamespace(film_sizes=[(4096, 4096)] * views)

    def cells(settings: dict | None = None) -> int:
        chosen = configured("sampler", name, settings)
        looks = chosen.works.__new__(chosen.works)  # nothing is built for so many pixels
        looks.settings, looks.problem = chosen, films
        return looks.resolution(65536)

    assert cells() == side and cells({"stage1.resolution": 200}) == 200
