"""Small sets of photographs in every format, of cameras that are known."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from isas_cli.runtime import images

# Picture, focal lengths and principal point: nothing is symmetric, so that no slip hides.
SIZE = 40, 30
FOCAL = 55.0
CENTRE = 23.5, 11.25


def look_at(origin, target, up=(0.0, 1.0, 0.0)) -> np.ndarray:
    """Camera to world, ``(4, 4)``, x right, y down, z forward."""
    forward = np.subtract(target, origin) / np.linalg.norm(np.subtract(target, origin))
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.column_stack([right, np.cross(forward, right), forward, origin])
    return pose


_PLACES = (2.0, 1.0, 2.5), (-2.2, 0.4, 1.5), (0.3, 1.8, -2.4)
POSES = [look_at(place, (0.1, 0.0, -0.1)) for place in _PLACES]


@dataclass(frozen=True)
class Files:
    """What the pictures of a set are: ``pictures`` ``(H, W, 3)`` linear, one a pose, or grey."""

    folder: Path
    poses: list
    pictures: list | None = None

    def names(self, ending: str = ".exr") -> list[str]:
        """Writes the pictures and says what they are called."""
        found = []
        for number in range(len(self.poses)):
            name = f"view_{number}{ending}"
            pixels = np.full((SIZE[1], SIZE[0], 3), 0.4, np.float32)
            if self.pictures is not None:
                pixels = self.pictures[number]
            if ending == ".exr":
                images.write_exr(self.folder / name, pixels, ["R", "G", "B"], {})
            else:
                images.write_png(self.folder / name, images.to_display(pixels))
            found.append(name)
        return found


def in_parts(path: Path, **parts: tuple[str, np.ndarray]) -> Path:
    """An EXR of several parts, by name: letters of its channels, and pixels ``(H, W, C)``."""
    specs = []
    for name, (letters, pixels) in parts.items():
        height, width, count = pixels.shape
        specs.append(oiio.ImageSpec(width, height, count, oiio.FLOAT))
        specs[-1].channelnames = tuple(letters)
        specs[-1].attribute("oiio:subimagename", name)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), specs)
    for number, (_, pixels) in enumerate(parts.values()):
        if number:
            assert output.open(str(path), specs[number], "AppendSubimage")
        assert output.write_image(pixels)
    output.close()
    return path


def transforms(files: Files, **more) -> dict:
    """nerfstudio's; ``more`` replaces entries at the top."""
    flipped = np.diag([1.0, -1.0, -1.0, 1.0])  # y up, z backward
    frames = [
        {"file_path": name, "transform_matrix": (pose @ flipped).tolist()}
        for name, pose in zip(files.names(), files.poses)
    ]
    intrinsics = {"fl_x": FOCAL, "fl_y": FOCAL, "cx": CENTRE[0], "cy": CENTRE[1]}
    found = {"w": SIZE[0], "h": SIZE[1], **intrinsics, "frames": frames, **more}
    return write(files.folder / "transforms.json", found)


def change(folder: Path, edit) -> None:
    """Has ``edit`` change what is in a transforms.json."""
    file = folder / "transforms.json"
    content = json.loads(file.read_text())
    edit(content)
    write(file, content)


def blender(files: Files) -> dict:
    """An angle of view, no principal point, no endings."""
    files.names(".png")
    flipped = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [
        {"file_path": f"./view_{number}", "transform_matrix": (pose @ flipped).tolist()}
        for number, pose in enumerate(files.poses)
    ]
    angle = 2 * math.atan(SIZE[0] / 2 / FOCAL)
    found = {"camera_angle_x": angle, "frames": frames}
    return write(files.folder / "transforms_train.json", found)


def ours(files: Files, **more) -> dict:
    """Pixels counted from the first one's middle."""
    inner = [[FOCAL, 0, CENTRE[0] - 0.5], [0, FOCAL, CENTRE[1] - 0.5], [0, 0, 1]]
    views = [
        {"image": name, "world_to_camera": np.linalg.inv(pose).tolist()}
        for name, pose in zip(files.names(".png"), files.poses)
    ]
    found = {"width": SIZE[0], "height": SIZE[1], "camera_matrix": inner, "views": views, **more}
    return write(files.folder / "cameras.json", found)


def colmap(files: Files, model: str = "PINHOLE", numbers=None) -> None:
    """Text, with two points that some views found, and pictures in images/."""
    from scipy.spatial.transform import Rotation

    numbers = numbers or (FOCAL, FOCAL, *CENTRE)
    (files.folder / "images").mkdir()
    names = Files(files.folder / "images", files.poses, files.pictures).names(".png")
    sparse = files.folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    text = " ".join(map(str, numbers))
    (sparse / "cameras.txt").write_text(f"# lens\n1 {model} {SIZE[0]} {SIZE[1]} {text}\n")
    lines = ["# two lines an image"]
    for number, (name, pose) in enumerate(zip(names, files.poses), 1):
        inverse = np.linalg.inv(pose)
        x, y, z, w = Rotation.from_matrix(inverse[:3, :3]).as_quat()
        numbers = " ".join(map(repr, map(float, (w, x, y, z, *inverse[:3, 3]))))
        lines += [f"{number} {numbers} 1 {name}", "1.5 2.5 7 3.0 4.0 -1" if number == 1 else ""]
    (sparse / "images.txt").write_text("\n".join(lines) + "\n")
    (sparse / "points3D.txt").write_text("# points\n7 0.1 0.2 0.3 0 0 0 0.5 1 0\n9 1 1 1 0 0 0 1\n")


def neus(files: Files, centre=None, factor=1.0, name="cameras_sphere.npz", **more) -> None:
    """As IDR, VolSDF and NeuS have it. ``centre``: counted from the first pixel's middle;
    ``factor``: what matrices are known up to; ``more`` replaces some."""
    folder = files.folder / "image"
    folder.mkdir(exist_ok=True)
    Files(folder, files.poses).names(".png")
    x, y = centre or (CENTRE[0] - 0.5, CENTRE[1] - 0.5)
    inner = np.array([[FOCAL, 0, x, 0], [0, FOCAL, y, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    found = {f"scale_mat_{n}": np.diag([3.0, 3.0, 3.0, 1.0]) for n in range(len(files.poses))}
    for number, pose in enumerate(files.poses):
        found[f"world_mat_{number}"] = factor * inner @ np.linalg.inv(pose)
    np.savez(files.folder / name, **(found | more))


def llff(files: Files) -> None:
    """Axes down, right, backward, and the principal point in the middle."""
    (files.folder / "images").mkdir(exist_ok=True)
    Files(files.folder / "images", files.poses).names(".png")
    rows = []
    for pose in files.poses:
        right, down, forward, place = pose[:3].T
        columns = [down, right, -forward, place, [*SIZE[::-1], FOCAL]]
        rows.append([*np.column_stack(columns).ravel(), 0.5, 9.0])
    np.save(files.folder / "poses_bounds.npy", np.array(rows))


def meshroom(files: Files, version=(1, 2, 6), **more) -> dict:
    """AliceVision's, with a view without a pose, of pictures that are elsewhere now. From 1.2.3 on
    files.poses are where its mesh is. ``more`` replaces entries of the intrinsic."""
    turn = np.diag([1.0, -1.0, -1.0, 1.0]) if version >= (1, 2, 3) else np.eye(4)
    views = [
        {"viewId": n, "poseId": n, "intrinsicId": 5, "path": f"/gone/{name}", "metadata": []}
        for n, name in enumerate([*files.names(".png"), "lost.png"])
    ]
    poses = [
        {"poseId": n, "pose": {"transform": rigid(turn @ pose), "locked": False}}
        for n, pose in enumerate(files.poses)
    ]
    inner = {
        **{"intrinsicId": 5, "width": SIZE[0], "height": SIZE[1], "type": "pinhole"},
        **{"sensorWidth": 36, "focalLength": FOCAL * 36 / SIZE[0], "pixelRatio": 1},
        "principalPoint": [c - 0.5 - size / 2 for c, size in zip(CENTRE, SIZE)],
        "distortionParams": [],
        **more,
    }
    found = {"version": version, "views": views, "intrinsics": [inner], "poses": poses}
    return write(files.folder / "cameras.sfm", strings(found))


def rigid(pose: np.ndarray) -> dict:
    """As AliceVision has it: to the camera, column after column."""
    return {"rotation": np.linalg.inv(pose)[:3, :3].ravel("F"), "center": pose[:3, 3]}


def strings(value):
    """As boost writes JSON: numbers are strings, and so is an empty list."""
    if isinstance(value, dict):
        return {key: strings(each) for key, each in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [strings(each) for each in value] or ""
    return value if isinstance(value, str) else json.dumps(value)


def openmvg(files: Files, kind="pinhole", **more) -> dict:
    """With a view without a pose, and two cameras of one kind. ``more`` is added to their
    numbers."""
    data = {"width": SIZE[0], "height": SIZE[1], "focal_length": FOCAL}
    data |= {"principal_point": [c - 0.5 for c in CENTRE], **more}

    def entry(key: int, content: dict, **named) -> dict:
        pointer = {"id": (1 << 31) + key, "data": content}
        return {"key": key, "value": {**named, "ptr_wrapper": pointer}}

    views = [
        entry(
            n,
            {"local_path": "", "filename": name, "id_view": n, "id_intrinsic": n % 2, "id_pose": n},
            polymorphic_id=1 << 30,
        )
        for n, name in enumerate([*files.names(".png"), "lost.png"])
    ]
    first = {"polymorphic_id": (1 << 31) + 1, "polymorphic_name": kind}
    poses = [
        {"rotation": np.linalg.inv(p)[:3, :3].tolist(), "center": p[:3, 3].tolist()}
        for p in files.poses
    ]
    found = {
        **{"sfm_data_version": "0.3", "root_path": "/gone", "views": views},
        "intrinsics": [entry(0, data, **first), entry(1, data, polymorphic_id=1)],
        "extrinsics": [{"key": n, "value": pose} for n, pose in enumerate(poses)],
        **{"structure": [], "control_points": []},
    }
    return write(files.folder / "sfm_data.json", found)


def write(path: Path, content: dict) -> dict:
    path.write_text(json.dumps(content))
    return content
