"""A light that is given, and the borders of pictures: said before anything is rendered."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import photo_sets
import pytest
import trimesh
from photo_sets import Files, look_at
from PIL import Image
from test_photo_alike import AROUND, HALF, picture

from isas_cli.config.schema import PhotosConfig
from isas_cli.runtime import images
from isas_cli.scene.photos import borders, photographs, surroundings

# From a world whose up is y to one whose up is z, and upside down.
TURNS = {"y": np.eye(3), "z": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "-y": np.diag([1, -1, -1])}
ASIDE = [look_at((x, 0.5, 2.5), (0.0, 0.0, 0.0)) for x in (-0.5, 0.1, 0.6)]


def told(folder, poses=AROUND, turn="y", pictures=None, **settings) -> list[str]:
    """Of views of a box, in a world turned as ``TURNS`` say."""
    world = np.eye(4)
    world[:3, :3] = TURNS[turn]
    pictures = pictures or [picture(pose) for pose in poses]
    photo_sets.transforms(Files(folder, [world @ pose for pose in poses], pictures))
    trimesh.creation.box(2 * HALF, world).export(folder / "box.ply")
    lines = photographs.load(replace(asked(folder), **settings)).warnings
    return [line for line in lines if "has no texture coordinates" not in line]


def asked(folder) -> PhotosConfig:
    return PhotosConfig(path=str(folder), mesh=str(folder / "box.ply"), saturated=None)


def sky(path, wide=32, high=16, most=5.0) -> str:
    pixels = np.linspace(0.1, most, wide * high * 3, dtype=np.float32).reshape(high, wide, 3)
    if path.suffix == ".exr":
        images.write_exr(path, pixels, ["R", "G", "B"], {})
        path.write_bytes(path.read_bytes().replace(b"isas 0", b"else 0"))  # who wrote it
    else:
        Image.fromarray(images.to_display(pixels)).save(path)
    return str(path)


def test_a_light_that_fits_is_passed_without_a_word(tmp_path):
    for name, more in (("a.exr", {}), ("b.png", {"most": 0.9}), ("c.exr", {"wide": 17, "high": 8})):
        assert told(tmp_path, environment=sky(tmp_path / name, **more)) == []
    Image.new("RGB", (16, 8), (255, 255, 255)).save(tmp_path / "white.png")  # of one colour
    assert told(tmp_path, environment=str(tmp_path / "white.png")) == []


def test_light_that_whole_numbers_cut_off(tmp_path):
    (line,) = told(tmp_path, environment=sky(tmp_path / "sky.png"))
    assert "sky.png" in line and "is cut off" in line and "EXR" in line


def test_a_light_whose_colours_cannot_be_heeded(tmp_path):
    lit = tmp_path / "sky.png"
    Image.new("RGB", (16, 8), (255, 255, 255)).save(lit, icc_profile=b"x")
    (line,) = told(tmp_path, environment=str(lit))
    assert line.startswith("a colour profile")
    assert line.endswith(f" of {lit} cannot be heeded: convert it to sRGB")


@pytest.mark.parametrize("wide, high", [(16, 16), (24, 32), (32, 24)])
def test_a_light_of_another_shape(tmp_path, wide, high):
    (line,) = told(tmp_path, environment=sky(tmp_path / "probe.exr", wide, high))
    assert f"probe.exr: {wide}×{high} pixels" in line and "twice as wide as high" in line


@pytest.mark.parametrize("turn", ["z", "-y"])
def test_cameras_that_stand_upright_about_another_axis(tmp_path, turn):
    lit = sky(tmp_path / "sky.exr")
    (line,) = told(tmp_path, turn=turn, environment=lit)
    assert f"upright about {turn}" in line and f"photos.up={turn}" in line
    assert told(tmp_path, turn=turn, environment=lit, up=turn) == []
    # From one side they may be turned as well; and a run's own light is in the axes that it had.
    assert told(tmp_path, ASIDE, turn=turn, environment=lit) == []
    images.write_exr(tmp_path / "own.exr", images.read(lit), ["R", "G", "B"], {})
    assert told(tmp_path, turn=turn, environment=str(tmp_path / "own.exr")) == []


def test_the_light_of_other_commands_is_named_as_they_name_it(tmp_path):
    lit = Path(sky(tmp_path / "probe.exr", 16, 16))
    told(tmp_path, turn="z")
    cameras = [each.camera for each in photographs.load(asked(tmp_path)).all]
    names = "--light ", "--up="
    shape, up = surroundings.doubts(lit, "y", cameras, names)
    assert shape.startswith(f"--light {lit}: 16×16 pixels are read as longitude and latitude")
    assert up.startswith(f"--light {lit}: its up is --up=y, but") and up.endswith("take --up=z")
    # Of lights that stand to each camera nothing is up.
    assert surroundings.doubts(lit, None, cameras, names) == [shape]


@pytest.mark.parametrize(
    "light, how", [(0.02, "multiply"), (0.3, None), (1.0, None), (15.0, None), (100.0, "divide")]
)
def test_a_light_of_another_unit_than_the_pictures(tmp_path, light, how):
    """The object is about as bright as 0.4, before white, which does not count."""
    pixels = np.full((16, 32, 3), light, np.float32)
    images.write_exr(tmp_path / "sky.exr", pixels, ["R", "G", "B"], {})
    lines = told(tmp_path, environment=str(tmp_path / "sky.exr"))
    assert len(lines) == (how is not None)
    if how is None:
        return
    by = max(light * 0.3 / 0.4, 0.4 / light / 0.3)
    (line,) = lines
    assert "sky.exr: the pictures show the object" in line and "in another unit" in line
    assert f"{how} it by about" in line and float(line.split()[-1]) == pytest.approx(by, rel=0.3)
    # A base colour that is known cannot make up for it.
    taken = photographs.load(replace(asked(tmp_path), environment=str(tmp_path / "sky.exr")))
    known = replace(taken.settings, texture="colour.png")
    assert surroundings.unit(taken.settings, taken.all, taken.surface) == [line]
    assert surroundings.unit(known, taken.all, taken.surface) == []


def rim(shown: np.ndarray) -> np.ndarray:
    found = shown.copy()
    found[:2] = found[-2:] = found[:, :4] = found[:, -3:] = 0
    return found


def test_black_borders_that_the_object_reaches(tmp_path):
    """Of close views, as undistortion leaves them; of views from afar it does not reach them, nor
    does it reach into a black background."""
    near = []
    for pose in AROUND:
        near.append(pose.copy())
        near[-1][:3, 3] *= 0.45
    (line,) = told(tmp_path, near, pictures=[rim(picture(pose)) for pose in near])
    assert "black along their borders" in line and "in 8 of 8, first view_0.exr" in line
    assert told(tmp_path, near) == []
    assert told(tmp_path, pictures=[rim(picture(pose)) for pose in AROUND]) == []
    before = [np.where(shown == np.float32(0.9), 0, shown) for shown in map(picture, near)]
    assert told(tmp_path, near, pictures=before) == []
    # An alpha that is whole says nothing of them.
    told(tmp_path, near, pictures=[rim(picture(pose)) for pose in near])
    taken = photographs.load(asked(tmp_path))
    for each in taken.all:
        each.lost["transparent"] = 0
    assert borders.doubts(taken.all, taken.surface) == [line]
