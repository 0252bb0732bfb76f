"""Poses and meshes that do not fit what the pictures show: said before anything is rendered."""

import numpy as np
import photo_sets
import pytest
import trimesh
from photo_sets import CENTRE, FOCAL, SIZE, Files, look_at

from isas_cli.config.schema import PhotosConfig
from isas_cli.scene.photos import brightness, photographs

PLACES = [(2.0, 0.9, 2.0), (1.6, 1.1, 2.4), (2.4, 0.8, 1.6), (1.9, 1.4, 1.9), (2.2, 0.5, 2.2)]
POSES = [look_at(place, (0.0, 0.0, 0.0)) for place in PLACES]
AROUND = [
    look_at((2.6 * np.cos(a), (-1) ** k * 1.2, 2.6 * np.sin(a)), (0.0, 0.0, 0.0))
    for k, a in enumerate(np.radians(np.arange(20, 380, 45)))
]
HALF = np.array([0.5, 0.4, 0.3])


def picture(pose, lamp=None) -> np.ndarray:
    """Of a box with waves on it, before white. ``lamp``: where light comes from, in the camera's
    axes; else it comes from everywhere."""
    rows, columns = np.indices(SIZE[::-1]) + 0.5
    rays = np.stack([(columns - CENTRE[0]) / FOCAL, (rows - CENTRE[1]) / FOCAL, 1 + 0 * rows], -1)
    rays = rays @ pose[:3, :3].T
    ends = np.stack([(side * HALF - pose[:3, 3]) / rays for side in (-1, 1)])
    near, far = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
    x, y, z = np.moveaxis(pose[:3, 3] + rays * near[..., None], -1, 0)
    wave = 0.4 + 0.3 * np.sin(7 * x + 2) * np.sin(8 * y + 1) + 0.25 * np.sin(9 * z + 5 * x)
    if lamp is not None:
        place = np.stack([x, y, z], axis=-1) / HALF
        facing = np.eye(3)[np.abs(place).argmax(axis=-1)] * np.sign(place)
        wave = (0.6 + 0.2 * wave) * (0.3 + 0.7 * np.clip(facing @ pose[:3, :3] @ lamp, 0, 1))
    shown = np.where(near < far, np.clip(wave, 0.02, 1), 0.9)
    return np.repeat(shown[..., None], 3, axis=2).astype(np.float32)


def told(folder, poses=POSES, turn=None, pictures=None) -> list[str]:
    pictures = pictures or [picture(pose) for pose in POSES]
    photo_sets.transforms(Files(folder, poses, pictures))
    box = trimesh.creation.box(2 * HALF)
    if turn is not None:
        box.apply_transform(turn)
    box.export(folder / "box.ply")
    return said(PhotosConfig(path=str(folder), mesh=str(folder / "box.ply"), saturated=None))


def said(asked: PhotosConfig) -> list[str]:
    lines = photographs.load(asked).warnings
    return [line for line in lines if "has no texture coordinates" not in line]


def test_what_fits_is_not_doubted(tmp_path):
    assert told(tmp_path) == []


def test_a_picture_of_another_view(tmp_path):
    pictures = [picture(pose) for pose in POSES]
    pictures[2] = picture(look_at((-2.0, 0.8, -2.0), (0.0, 0.0, 0.0)))
    (line,) = told(tmp_path, pictures=pictures)
    assert "1 of 5 views show the object's places unlike all others, first view_2.exr" in line


@pytest.mark.parametrize("at", [(4.0, 1.8, 4.0), (2.0, 9.0, 2.0)])
def test_a_view_that_looks_elsewhere(tmp_path, at):
    poses = [*POSES[:3], look_at(PLACES[3], at, (0.0, 0.1, 1.0)), POSES[4]]
    (line,) = told(tmp_path, poses)
    assert "in 1 of 5 views behind the camera or outside the picture, first view_3.exr" in line


def test_a_mesh_whose_up_is_another(tmp_path):
    """As programs whose up is z export what stands in a world whose up is y."""
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])
    pictures = [picture(pose) for pose in AROUND]
    assert told(tmp_path, AROUND, pictures=pictures) == []
    (line,) = told(tmp_path, AROUND, turn, pictures)
    assert "if the mesh's axes x, y, z become" in line and "mirrored" not in line


def apart(scale: float = 1.0, turn: float = 0.0) -> np.ndarray:
    found = trimesh.transformations.rotation_matrix(turn, [0.3, 1, 0.2])
    found[:3, :3] *= scale
    return found


def mirror(pose) -> np.ndarray:
    """The box, each view of which has waves of its own."""
    shown, wave = picture(pose), np.sin(np.indices(SIZE[::-1])[1] * (0.5 + pose[0, 3] / 9))
    return np.where(shown == np.float32(0.9), shown, 0.3 + 0.2 * wave[..., None]).astype(np.float32)


@pytest.mark.parametrize("turn", [apart(1.4, 0.6), apart(0.5), apart(1.9)])
def test_a_mesh_that_stands_elsewhere(tmp_path, turn):
    (line,) = told(tmp_path, AROUND, turn, [picture(pose) for pose in AROUND])
    assert "unlike, and its outline lies on no edges of theirs" in line


def test_pictures_that_were_cropped(tmp_path):
    """By 7 pixels to one side and 5 to another, so that their principal point is elsewhere."""
    pictures = [np.roll(picture(pose), (-5, -7), (0, 1)) for pose in AROUND]
    (line,) = told(tmp_path, AROUND, pictures=pictures)
    assert "cropped" in line


def test_a_mirror_is_not_doubted(tmp_path):
    """No two views show its places alike, but its outline is where it should be."""
    assert told(tmp_path, AROUND, pictures=[mirror(pose) for pose in AROUND]) == []


@pytest.mark.parametrize("lamp", [None, (0.9, -0.3, -0.3)])
def test_a_light_that_goes_with_the_camera(tmp_path, lamp):
    """As of a turntable, or a flash."""
    photo_sets.transforms(Files(tmp_path, AROUND, [picture(pose, lamp) for pose in AROUND]))
    trimesh.creation.box(2 * HALF).export(tmp_path / "box.ply")
    asked = PhotosConfig(str(tmp_path), mesh=str(tmp_path / "box.ply"), saturated=None)
    taken = photographs.load(asked)
    factor = brightness.moved(taken.all, taken.surface)
    assert factor is None if lamp is None else factor > 1.1


@pytest.mark.parametrize("form", ["transforms", "ours"])
def test_poses_that_lead_the_other_way(tmp_path, form):
    """From world to camera where the file means from camera to world, or the reverse."""
    pictures = [picture(pose) for pose in AROUND]
    content = getattr(photo_sets, form)(Files(tmp_path, AROUND, pictures))
    trimesh.creation.box(2 * HALF).export(tmp_path / "box.ply")
    asked = PhotosConfig(str(tmp_path), mesh=str(tmp_path / "box.ply"), saturated=None)
    assert said(asked) == []
    name, entries, key = {
        "transforms": ("transforms.json", "frames", "transform_matrix"),
        "ours": ("cameras.json", "views", "world_to_camera"),
    }[form]
    for each in content[entries]:
        each[key] = np.linalg.inv(each[key]).tolist()
    photo_sets.write(tmp_path / name, content)
    (line,) = said(asked)
    assert "behind the camera or outside the picture, and in none if each pose is inverted" in line
