"""Directions to the map of a sky: weighed by the density that they are drawn with."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from problems_for_tests import built
from xml_for_tests import camera

from isas_cli.rendering import light, sky
from isas_cli.runtime import images

COUNT = 1 << 20


def texels(lamp: tuple[int, int], size=(32, 64)) -> np.ndarray:
    """A sky that is dark below, with a lamp that outshines it."""
    found = np.random.default_rng(4).uniform(0.1, 0.3, (*size, 3)).astype(np.float32)
    found[size[0] // 2 :] = 0
    found[lamp] = 500
    return found


def scene(pixels: np.ndarray, **more) -> mi.Scene:
    turned = mi.ScalarTransform4f().rotate([0.6, 0.8, 0], 40)
    above = {"type": "envmap", "bitmap": mi.Bitmap(pixels), "to_world": turned, "scale": 2.0}
    return mi.load_dict({"type": "scene", "integrator": {"type": "prb"}, "sky": above, **more})


def points(seed: int) -> mi.Point2f:
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, COUNT)
    return sampler.next_2d()


def radiance(loaded: mi.Scene, direction: mi.Vector3f) -> mi.Float:
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = -direction
    return mi.luminance(loaded.environment().eval(si))


def by_mitsuba(loaded: mi.Scene, seed: int) -> tuple[float, float]:
    """The light of the whole sky, and its standard error."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    weight = loaded.sample_emitter_direction(si, points(seed), False)[1]
    return mean(mi.luminance(weight))


def mean(values: mi.Float) -> tuple[float, float]:
    values = np.array(values, np.float64)
    return values.mean(), values.std() / len(values) ** 0.5


@pytest.mark.parametrize("size", [(32, 64), (9, 31)])
def test_what_is_drawn_and_what_it_is_weighed_by_agree(size, seed, monkeypatch):
    monkeypatch.setattr(sky, "_LANES", 5000)  # read in several bands
    loaded = scene(texels((7, 13), size))
    drawn = sky.of_map(loaded)
    direction, density = drawn.draw(points(seed))
    assert np.allclose(np.array(dr.norm(direction)), 1, atol=1e-5)
    # But for directions on a border between cells.
    again = np.array(drawn.pdf(direction, mi.Bool(True)))
    assert np.mean(np.abs(again / np.array(density) - 1) < 1e-2) > 0.99
    uniform = mi.warp.square_to_uniform_sphere(points(seed + 1))
    whole, error = mean(drawn.pdf(uniform, mi.Bool(True)) * (4 * dr.pi))
    assert abs(whole - 1) < 5 * error < 0.3
    (found, own), (wanted, other) = (
        mean(radiance(loaded, direction) / density),
        by_mitsuba(loaded, 9),
    )
    assert abs(found - wanted) < 5 * np.hypot(own, other)
    assert own < 0.3 * mean(radiance(loaded, uniform) * (4 * dr.pi))[1]


@pytest.mark.parametrize("strange", [np.nan, np.inf, -1e6])
def test_a_map_with_a_strange_texel_is_drawn_all_the_same(strange, seed):
    pixels = texels((7, 13))
    pixels[20, 3] = strange
    density = np.array(sky.of_map(scene(pixels)).draw(points(seed))[1])
    assert np.all(np.isfinite(density)) and np.all(density > 0)


def test_light_is_found_where_the_map_that_was_read_had_none(seed):
    """As after a change of the map: nothing is biased, there only is more noise."""
    above = texels((7, 13))
    above[7, 13] = 0.2
    drawn, other = sky.of_map(scene(above)), scene(above[::-1].copy())
    direction, density = drawn.draw(points(seed))
    (found, own), (wanted, _) = mean(radiance(other, direction) / density), by_mitsuba(other, 9)
    assert abs(found - wanted) < 5 * own < 0.5 * wanted


def test_a_sky_without_light_is_drawn_evenly(seed):
    values = np.zeros((8, 16, 3), np.float32)
    values[3, 4] = -1
    drawn = sky.of_map(scene(values))
    direction, density = (np.array(each) for each in drawn.draw(points(seed)))
    assert np.all(np.isfinite(density)) and np.all(density > 0)
    # No side rules, least of all where the map is below nothing.
    assert np.abs(direction.mean(axis=-1)).max() < 0.2


def test_large_maps_are_read_in_coarser_cells(monkeypatch):
    monkeypatch.setattr(sky, "_LEAST_CELLS", 1)
    monkeypatch.setattr(sky, "_MOST_CELLS", 500)
    drawn = sky.of_map(scene(texels((7, 13))))
    assert drawn.rows * drawn.columns < 1000
    direction, density = drawn.draw(points(1))
    found, error = mean(radiance(scene(texels((7, 13))), direction) / density)
    assert abs(found - by_mitsuba(scene(texels((7, 13))), 3)[0]) < 5 * error < 0.1 * found


def test_only_a_map_that_is_the_only_light_and_varies_is_read():
    lamp = {"type": "point", "position": [0, 2, 0], "intensity": 1.0}
    assert sky.of_map(scene(texels((7, 13)))) is not None
    assert sky.of_map(scene(texels((7, 13)), bulb=lamp)) is None
    assert sky.of_map(scene(np.full((7, 13, 3), (0.2, 0.3, 0.5), np.float32))) is None
    constant = {"type": "scene", "integrator": {"type": "prb"}, "sky": {"type": "constant"}}
    assert sky.of_map(mi.load_dict(constant)) is None


@pytest.mark.parametrize("name, read", [("pottery", True), ("object_joint", False)])
def test_runs_read_the_map_unless_it_is_unknown(name, read):
    made = built(f"scene={name}", "size=tiny", "target.spp=1")
    assert (light.sky_for(made.scene, 4) is not None) == read


@pytest.mark.parametrize("integrator, read", [('<integrator type="path"/>', True), ("", False)])
def test_files_read_it_where_they_name_an_integrator(integrator, read, tmp_path):
    """Without one, there is nothing in the scene that could hold it."""
    images.write_exr(tmp_path / "sky.exr", texels((7, 13)), [*"RGB"], {})
    text = f"""<scene version="3.0.0">{integrator}
      <emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>
      <shape type="sphere" id="ball"><bsdf type="diffuse" id="white"/></shape>
      {camera("0,0,5", 8)}</scene>"""
    (tmp_path / "scene.xml").write_text(text, encoding="utf-8")
    unknowns = 'scene.unknowns={"ball.bsdf.reflectance.value": {"start": 0.3}}'
    made = built("scene=file", f"scene.path={tmp_path / 'scene.xml'}", "target.spp=1", unknowns)
    assert (light.sky_for(made.scene, 4) is not None) == read
