"""The distribution over all pixels of all views."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from montecarlo import chi_square, z_against

from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime import streams
from isas_cli.samplers.stage1.cells import Cells
from isas_cli.scene.views import Views


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


def test_slots_are_found_back():
    views = Views.of([(300, 140), (7, 3), (33, 257)])
    slot = dr.arange(mi.UInt32, views.total)
    assert np.array_equal(np.array(views.slot(*views.locate_slot(slot))), np.array(slot))


def test_one_view():
    views = Views.of([(3, 2)])
    view, column, row = views.locate(dr.arange(mi.UInt32, 6))
    assert np.all(np.array(view) == 0)  # one entry: broadcasts
    assert np.array(column).tolist() == [0, 1, 2, 0, 1, 2]
    assert np.array(row).tolist() == [0, 0, 0, 1, 1, 1]


def line(count: int, **settings) -> Tiles:
    """The tiles of one film of a single row."""
    return Tiles.over(Views.of([(count, 1)]), **settings)


def on_line(weights, floor: float = 0.0) -> PixelDistribution:
    return PixelDistribution.from_weights(mi.Float(weights), line(len(weights)), floor)


def probabilities(d: PixelDistribution) -> np.ndarray:
    """p_j of all pixels in the order in which images are stored."""
    views = d.tiles.views
    return np.array(d.probability(*views.locate(dr.arange(mi.UInt32, views.total))), np.float64)


@pytest.mark.parametrize("floor", [0.0, 0.1, 1.0])
def test_probabilities_are_the_mixture_and_sum_to_one(floor):
    weights = np.random.default_rng(0).exponential(1, 1000).astype(np.float32)
    weights[::3] = 0
    p = probabilities(on_line(weights, floor))
    exact = (1 - floor) * weights / weights.sum(dtype=np.float64) + floor / 1000
    assert np.allclose(p, exact, rtol=1e-6, atol=1e-12)
    assert abs(p.sum() - 1) < 1e-6


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_unusable_weights_count_as_zero(bad):
    weights = np.array([1, bad, 3], np.float32)
    assert np.allclose(probabilities(on_line(weights)), [0.25, 0, 0.75])


def test_no_weight_at_all_is_uniform():
    assert np.allclose(probabilities(on_line(np.zeros(8, np.float32), 0.1)), 1 / 8)


def draw(d: PixelDistribution, count: int, seed: int) -> np.ndarray:
    # Opaque, or every seed would compile a kernel of its own.
    view, column, row, _ = d.draw(count, dr.opaque(mi.UInt32, seed))
    return np.array(d.tiles.views.index(view, column, row))


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
    d = on_line(cases()[name].astype(np.float32))
    p = probabilities(d)

    # Each of a stream of its own.
    seeds = mi.UInt32([streams.seed(5, i, "draw") for i in range(3000)])
    view, column, row, _ = d.draw(1, seeds)
    single = np.array(d.tiles.views.index(view, column, row))
    assert single.size == 3000
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
    d = on_line(weights)
    counts = np.zeros(300)
    for i in range(40):
        counts += np.bincount(draw(d, 970, i), minlength=300)
    assert chi_square(counts, np.full(300, 1 / 300)) < 1e-6


def test_expected_draws_are_exact_per_stratum():
    """Stratified: a pixel with probability k/N is drawn k times or within one of it."""
    drawn = draw(on_line([1.0, 2.0, 5.0, 8.0]), 1600, 9)
    counts = np.bincount(drawn, minlength=4)
    assert np.all(np.abs(counts - np.array([100, 200, 500, 800])) <= 1)
    assert np.all(np.diff(drawn.astype(int)) >= 0)


def test_tiles_cover_every_pixel_once():
    """Cut off at the borders, no larger than asked, and few."""
    views = Views.of([(50, 31), (7, 64), (1, 1)])
    for most, finest, side in ((10**6, np.inf, 1), (200, np.inf, 4), (200, 2.9, 2)):
        tiles = Tiles.over(views, most, finest)
        assert tiles.side == side
        view, column, row, width, height = (
            np.array(a, int) for a in tiles.corner(dr.arange(mi.UInt32, tiles.count))
        )
        covered = [np.zeros((h, w), int) for w, h in views.sizes]
        for v, x, y, w, h in zip(view, column, row, width, height):
            assert w > 0 and h > 0
            covered[v][y : y + h, x : x + w] += 1
        assert all(np.all(c == 1) for c in covered)


@pytest.mark.parametrize("resolution", [1, 128])
def test_meters_do_not_make_the_tiles_of_all_small(resolution):
    """Of cells that are as large as a view, as uniform sampling has them, or smaller; nor strips of
    a pixel's width."""
    large, counts = [(2048, 2048)] * 16, []
    for small in ([], [(1, 1)], [(1, 1), *[(30, 20)] * (resolution == 1)], [(1, 2048)]):
        sizes = large + small
        finest = Cells.over(sizes, resolution).finest
        counts.append(Tiles.over(Views.of(sizes), finest=finest).count)
    assert max(counts) == counts[0] == 1 << 20


def test_drawn_pixels_follow_the_pmf_within_tiles():
    """Tiles of four pixels' side, cut off at the borders, against the mixture by NumPy."""
    views = Views.of([(50, 31), (7, 20)])
    tiles = Tiles.over(views, 200)
    weights = np.random.default_rng(2).pareto(1.0, tiles.count).astype(np.float32)
    weights[::5] = 0
    d = PixelDistribution.from_weights(mi.Float(weights), tiles, 0.1)
    p = probabilities(d)
    view, column, row = views.locate(dr.arange(mi.UInt32, views.total))
    own = weights[np.array(tiles.slot(view, column, row))].astype(np.float64)
    assert np.allclose(p, 0.9 * own / own.sum() + 0.1 / views.total, rtol=1e-6)
    counts = sum(
        np.bincount(draw(d, 1000, streams.seed(7, i, "draw")), minlength=views.total)
        for i in range(100)
    )
    assert chi_square(counts, p) > 0.01
    again = d.draw(1000, mi.UInt32(3))
    assert np.allclose(np.array(again[3]), np.array(d.probability(*again[:3])), rtol=1e-6)


@pytest.mark.parametrize("floor", [0.0, 0.05, 1.0])
def test_a_film_of_one_pixel(floor):
    d = on_line(np.ones(1, np.float32), floor)
    assert probabilities(d).tolist() == [1.0]
    assert np.all(draw(d, 64, 1) == 0)


@pytest.mark.parametrize(
    "most",
    [1 << 20, pytest.param(1 << 27, marks=pytest.mark.slow)],
    ids=["tiles", "pixels"],
)
def test_mass_in_the_last_of_70_million_pixels(most):
    """More pixels than float32 has uniform numbers, all mass in the very last: it is found, its
    probability is exact, and without a floor nothing else is drawn. With a floor every pixel's
    probability is the mixture's to 1e-6, however small beside the largest."""
    views = Views.of([(9000, 7000), (2629, 2665)])  # ends in a tile of one pixel
    assert views.total > 70_000_000
    tiles = Tiles.over(views, most)
    last = tiles.views.locate(mi.UInt32(views.total - 1))
    *_, width, height = tiles.corner(tiles.slot(*last))
    assert int((width * height)[0]) == 1
    weights = dr.zeros(mi.Float, tiles.count)
    dr.scatter(weights, mi.Float(1e-30), tiles.slot(*last))
    d = PixelDistribution.from_weights(weights, tiles)
    assert abs(float(d.probability(*last)[0]) - 1) < 1e-6
    assert set(draw(d, 4096, 1)) == {views.total - 1}

    d = PixelDistribution.from_weights(weights, tiles, 0.05)
    drawn = draw(d, 65536, 2)
    assert abs((drawn == views.total - 1).mean() - 0.95) < 1e-3
    others = mi.UInt32(drawn[drawn != views.total - 1])
    p = np.array(d.probability(*views.locate(others)), np.float64)
    assert np.allclose(p * views.total, 0.05, rtol=1e-6)
    # Odd pixels as often as even ones: a 24-bit number would only reach some of them.
    odd = (np.array(others) % 2).mean()
    assert abs(odd - 0.5) < 4 * 0.5 / np.sqrt(dr.width(others))
    assert np.unique(np.array(others)).size == dr.width(others)


def test_a_distribution_takes_at_most_16_bytes_a_pixel():
    """8 bytes of running sum a tile, which is a pixel or more, beside a guide of bounded size."""
    for size, most in (((64, 64), 1 << 20), ((2000, 1500), 1 << 22), ((9000, 7000), 1 << 20)):
        tiles = Tiles.over(Views.of([size]), most)
        d = PixelDistribution.uniform(tiles)
        held = 8 * dr.width(d.cdf) + 4 * dr.width(d.guide)
        assert held <= 16 * tiles.views.total
    assert held < 0.2 * tiles.views.total  # of a large film: tiles, not pixels


def test_cells_upsample_what_is_linear_exactly():
    """A linear ramp over the cells' centres is reproduced between them and held at the border."""
    sizes = [(16, 8), (8, 16)]
    cells, views = Cells.over(sizes, 4), Views.of(sizes)
    assert cells.sizes == [(4, 2), (2, 4)]
    view, column, row = cells.views.locate(dr.arange(mi.UInt32, cells.count))
    tiles = Tiles.over(views)
    fine = cells.upsample(mi.Float(column), tiles)
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
    # Numbers that do not fit into 32 bits with their purpose: looks of a rehearsal that take
    # several streams an iteration reach them.
    late = [streams.seed(1, (1 << 27) + i, "draw") for i in range(2000)]
    assert len({*late, *seeds}) > len(late) + len(seeds) - 3
