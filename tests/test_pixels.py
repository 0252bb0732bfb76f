"""The distribution over all pixels of all views."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from montecarlo import chi_square, z_against

from isas_cli import streams
from isas_cli.pixels import PixelDistribution, Views
from isas_cli.samplers.cells import Cells


def test_views_locate_every_pixel():
    sizes = [(5, 3), (2, 7), (1, 1), (4, 4)]
    views = Views.of(sizes)
    view, column, row = views.locate(dr.arange(mi.UInt32, views.total))
    expected = [(v, x, y) for v, (w, h) in enumerate(sizes) for y in range(h) for x in range(w)]
    assert list(zip(*(np.array(a).tolist() for a in (view, column, row)))) == expected


def test_slots_are_all_pixels_once_in_compact_patches():
    sizes = [(300, 140), (7, 3), (33, 257)]
    views = Views.of(sizes)
    view, column, row = views.locate_slot(dr.arange(mi.UInt32, views.total))
    pixel = np.array(views.index(view, column, row))
    assert np.array_equal(np.sort(pixel), np.arange(views.total))
    x, y = np.array(column)[: 300 * 140], np.array(row)[: 300 * 140]
    for run, side in ((64, 8), (1024, 32)):
        first = slice(0, run)
        assert np.ptp(x[first]) < side and np.ptp(y[first]) < side


def test_one_view():
    views = Views.of([(3, 2)])
    view, column, row = views.locate(dr.arange(mi.UInt32, 6))
    assert np.all(np.array(view) == 0)  # one entry: broadcasts
    assert np.array(column).tolist() == [0, 1, 2, 0, 1, 2]
    assert np.array(row).tolist() == [0, 0, 0, 1, 1, 1]


@pytest.mark.parametrize("floor", [0.0, 0.1, 1.0])
def test_probabilities_are_the_mixture_and_sum_to_one(floor):
    weights = np.random.default_rng(0).exponential(1, 1000).astype(np.float32)
    weights[::3] = 0
    d = PixelDistribution.from_weights(mi.Float(weights), floor)
    p = np.array(d.probability(dr.arange(mi.UInt32, 1000)), np.float64)
    exact = (1 - floor) * weights / weights.sum(dtype=np.float64) + floor / 1000
    assert np.allclose(p, exact, rtol=1e-6, atol=1e-12)
    assert abs(p.sum() - 1) < 1e-6


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_unusable_weights_count_as_zero(bad):
    weights = np.array([1, bad, 3], np.float32)
    p = np.array(PixelDistribution.from_weights(mi.Float(weights)).probability(mi.UInt32(0, 1, 2)))
    assert np.allclose(p, [0.25, 0, 0.75])


def test_no_weight_at_all_is_uniform():
    d = PixelDistribution.from_weights(dr.zeros(mi.Float, 8), 0.1)
    assert np.allclose(np.array(d.probability(dr.arange(mi.UInt32, 8))), 1 / 8)


def draw(d: PixelDistribution, count: int, seed: int) -> np.ndarray:
    # Opaque, or every seed would compile a kernel of its own.
    return np.array(d.draw(count, dr.opaque(mi.UInt32, seed))[0])


def cases() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    return {
        "smooth": rng.uniform(0.5, 1.5, 300),
        "heavy": rng.pareto(1.0, 300),
        "sparse": np.where(rng.random(300) < 0.1, 1.0, 0.0),
        "one": np.eye(1, 300, 299)[0],
    }


@pytest.mark.parametrize("name", cases())
def test_drawn_pixels_follow_the_pmf(name):
    """χ² of independent draws (batches of one), and the mean counts of stratified batches."""
    d = PixelDistribution.from_weights(mi.Float(cases()[name].astype(np.float32)))
    p = np.array(d.probability(dr.arange(mi.UInt32, 300)), np.float64)

    single = [int(draw(d, 1, streams.seed(5, i, "draw"))[0]) for i in range(3000)]
    counts = np.bincount(single, minlength=300)
    assert np.all(counts[p == 0] == 0)
    assert chi_square(counts, p) > 0.01 / len(cases())

    batches = np.array(
        [np.bincount(draw(d, 97, streams.seed(6, i, "draw")), minlength=300) for i in range(128)]
    )
    common = (batches.std(axis=0) > 0) & (batches.sum(axis=0) > 20)  # where t is nearly normal
    if common.any():
        assert z_against(batches[:, common], 97 * p[common]) > 0.01 / len(cases())


def test_chi_square_notices_a_wrong_pmf():
    weights = np.random.default_rng(1).uniform(0.5, 1.5, 300).astype(np.float32)
    d = PixelDistribution.from_weights(mi.Float(weights))
    counts = np.zeros(300)
    for i in range(40):
        counts += np.bincount(draw(d, 970, i), minlength=300)
    assert chi_square(counts, np.full(300, 1 / 300)) < 1e-6


def test_expected_draws_are_exact_per_stratum():
    """Stratified: a pixel with probability k/N is drawn k times or within one of it."""
    d = PixelDistribution.from_weights(mi.Float([1.0, 2.0, 5.0, 8.0]))
    counts = np.bincount(np.array(d.draw(1600, mi.UInt32(9))[0]), minlength=4)
    assert np.all(np.abs(counts - np.array([100, 200, 500, 800])) <= 1)
    assert np.all(np.diff(np.array(d.draw(1600, mi.UInt32(9))[0]).astype(int)) >= 0)


def test_every_pixel_of_a_large_film_can_be_drawn():
    """20 M pixels of equal weight, more than float32 has uniform numbers: neighbours must
    not merge, and mass at the very end must be found."""
    n = 20_000_000
    d = PixelDistribution.uniform(n)
    last = mi.UInt32(n - 1)
    assert abs(float(d.probability(last)[0]) * n - 1) < 1e-6
    pixel = np.array(d.draw(4096, mi.UInt32(1))[0])
    assert np.unique(pixel).size == 4096
    # Odd pixels as often as even ones: a 24-bit number would only reach some of them.
    odd = sum(int((draw(d, 4096, s) % 2).sum()) for s in range(8))
    assert abs(odd - 4 * 4096) < 4 * np.sqrt(8 * 4096 / 4)


def test_cells_upsample_what_is_linear_exactly():
    """A linear ramp over the cells' centres is reproduced between them and held at the border."""
    sizes = [(16, 8), (8, 16)]
    cells, views = Cells.over(sizes, 4), Views.of(sizes)
    assert cells.sizes == [(4, 2), (2, 4)]
    view, column, row = cells.views.locate(dr.arange(mi.UInt32, cells.count))
    fine = cells.upsample(mi.Float(column), views)
    pixel = np.array(views.index(*views.locate_slot(dr.arange(mi.UInt32, views.total))))
    first = np.array(fine)[np.argsort(pixel)][:128].reshape(8, 16)
    inside = (np.arange(16) + 0.5) / 4 - 0.5
    assert np.allclose(first, np.clip(inside, 0, 3)[None, :], atol=1e-6)


def test_cells_place_samples_inside_their_own_cell():
    sizes = [(10, 7)]
    cells, views = Cells.over(sizes, 4), Views.of(sizes)
    view, x, y = (np.array(a) for a in cells.place(views, 50, mi.UInt32(3)))
    assert x.max() <= 9 and y.max() <= 6
    cell = np.arange(cells.count * 50) // 50
    columns = cells.sizes[0][0]
    scale = 10 / columns
    assert np.all(np.abs((x + 0.5) / scale - (cell % columns + 0.5)) <= 0.5 + 0.5 / scale)


def test_dilation_grows_by_one_cell_within_the_view():
    cells = Cells.over([(4, 4), (4, 4)], 4)
    weights = np.zeros(32, np.float32)
    weights[5] = 1
    grown = np.array(cells.dilate(mi.Float(weights)))
    assert grown[:16].reshape(4, 4)[:3, :3].sum() == 9 and grown.sum() == 9


def test_seeds_never_coincide_within_a_run():
    seeds = {streams.seed(1, i, p) for i in range(2000) for p in streams.PURPOSES}
    assert len(seeds) == 2000 * len(streams.PURPOSES)
    assert streams.seed(1, 5, "draw") != streams.seed(2, 5, "draw")
