"""The files that the scenes of plugins name: pictures, grids, meshes, curves and a measured lobe.

Numbers are drawn from a generator with a fixed seed, smooth where the eye would expect it, and
always inside the range of what they feed.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import mitsuba as mi
import numpy as np


def write(folder: Path) -> None:
    """All of them."""
    random = np.random.default_rng(4)
    colours = random.uniform(0.2, 0.8, (8, 8, 3))
    pictures = {
        "t.exr": colours,
        "g.exr": random.uniform(0.2, 0.7, (8, 8, 1)),
        "b.exr": random.uniform(0, 1, (8, 8, 1)),
        "e.exr": random.uniform(0.2, 1.2, (8, 16, 3)),
        "n.exr": _normals(random),
        "steep.exr": _normals(np.random.default_rng(5), 0.8),
    }
    for name, pixels in pictures.items():
        mi.Bitmap(pixels.astype(np.float32)).write(str(folder / name))
    grids = {
        "d.vol": random.uniform(0.3, 1.8, (4, 4, 4, 1)),
        "rgb.vol": random.uniform(0.3, 0.9, (4, 4, 4, 3)),
        "s.vol": _flakes(random),
        "sdf.vol": _distance(),
    }
    for name, numbers in grids.items():
        mi.VolumeGrid(numbers.astype(np.float32)).write(str(folder / name))
    _ball(folder, random)
    curve = "-0.9 -0.5 0 0.3\n-0.3 0.6 0.2 0.35\n0.3 -0.6 0 0.35\n0.9 0.5 0 0.3\n"
    # A B-spline ends short of its outer control points.
    (folder / "curve.txt").write_text("-1.6 -0.9 0 0.3\n" + curve + "1.6 0.9 0 0.3\n")
    _ellipsoids(folder / "ellipsoids.ply")
    _lobe(folder / "lobe.bsdf")


def _normals(random, most: float = 0.25) -> np.ndarray:
    """A normal map, ``(8, 8, 3)``: half of (unit normal + 1), of slopes up to ``most``."""
    tilt = random.uniform(-most, most, (8, 8, 2))
    normal = np.concatenate([tilt, np.ones((8, 8, 1))], axis=2)
    return 0.5 * (normal / np.linalg.norm(normal, axis=2, keepdims=True) + 1)


def _flakes(random) -> np.ndarray:
    """Matrices S of SGGX, ``(4, 4, 4, 6)``: xx, yy, zz, xy, xz, yz; positive definite."""
    sides = random.uniform(0.3, 1, (4, 4, 4, 3))
    return np.concatenate([sides, random.uniform(-0.1, 0.1, (4, 4, 4, 3))], axis=3)


def _distance() -> np.ndarray:
    """Distance from a sphere of radius 0.7 / 2 about the middle of the unit cube."""
    side = np.linspace(0, 1, 16)
    z, y, x = np.meshgrid(side, side, side, indexing="ij")
    return (np.sqrt((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.5) ** 2) - 0.35)[..., None]


def _ball(folder: Path, random) -> None:
    """A sphere of triangles, with coordinates, normals, and colours of vertices and faces."""
    rows, columns = 12, 24
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    polar, around = np.pi * v.ravel(), 2 * np.pi * u.ravel()
    points = np.stack(
        [np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)], axis=1
    )
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    below = first + columns + 1
    faces = np.concatenate(
        [np.stack([first, below, below + 1], 1), np.stack([first, below + 1, first + 1], 1)]
    )
    edges = points[faces]
    area = np.linalg.norm(np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0]), axis=1)
    faces = faces[area > 1e-6]  # at the poles every second one has none
    mesh = mi.Mesh(
        "ball", len(points), len(faces), has_vertex_normals=True, has_vertex_texcoords=True
    )
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    params = mi.traverse(mesh)
    for key, numbers in (("vertex_positions", points), ("vertex_normals", points)):
        params[key] = mi.Float(numbers.ravel().astype(np.float32))
    params["vertex_texcoords"] = mi.Float(uv.ravel().astype(np.float32))
    params["faces"] = mi.UInt32(faces.ravel().astype(np.uint32))
    params.update()
    mesh.write_ply(str(folder / "ball.ply"))
    counts = {"vertex": len(points), "face": len(faces)}
    for name, size in (("vertex_color", 3), ("vertex_grey", 1), ("face_color", 3)):
        numbers = random.uniform(0.2, 0.8, counts[name.partition("_")[0]] * size)
        mesh.add_attribute(name, size, mi.Float(numbers.astype(np.float32)))
        mesh.write_ply(str(folder / f"{name}.ply"))
        mesh.remove_attribute(name)
    _with_alpha(folder / "vertex_alpha.ply", points, uv, faces, random)
    _as_obj(folder / "ball.obj", points, uv, faces)
    _as_serialized(folder / "ball.serialized", points, uv, faces)


def _with_alpha(path: Path, points: np.ndarray, uv: np.ndarray, faces: np.ndarray, random) -> None:
    """A PLY with colours of four channels, which Mitsuba reads and does not write."""
    words = ["x", "y", "z", "nx", "ny", "nz", "u", "v", "r", "g", "b", "a"]
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    head += [f"property float {word}" for word in words]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    colours = random.uniform(0.2, 0.8, (len(points), 4))
    rows = np.concatenate([points, points, uv, colours], axis=1)
    lines = [" ".join(f"{number:.6f}" for number in row) for row in rows]
    lines += [" ".join(map(str, (3, *face))) for face in faces]
    path.write_text("\n".join(head + lines) + "\n")


def _as_obj(path: Path, points: np.ndarray, uv: np.ndarray, faces: np.ndarray) -> None:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points]
    lines += [f"vt {x:.6f} {y:.6f}" for x, y in uv]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points]
    lines += ["f " + " ".join(f"{i}/{i}/{i}" for i in face + 1) for face in faces]
    path.write_text("\n".join(lines) + "\n")


def _as_serialized(path: Path, points: np.ndarray, uv: np.ndarray, faces: np.ndarray) -> None:
    """Format 4: single precision, with normals and coordinates."""
    body = struct.pack("<I", 0x1000 | 0x1 | 0x2) + b"ball\0"
    body += struct.pack("<QQ", len(points), len(faces))
    body += b"".join(each.astype("<f4").tobytes() for each in (points, points, uv))
    body += faces.astype("<u4").tobytes()
    start = struct.pack("<HH", 0x041C, 4)
    path.write_bytes(start + zlib.compress(body) + struct.pack("<QI", 0, 1))


def _ellipsoids(path: Path) -> None:
    """Two, as Mitsuba reads them: place, normal, an attribute, size and quaternion."""
    words = ["x", "y", "z", "nx", "ny", "nz", "color_0", "color_1", "color_2"]
    words += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    rows = (
        [-0.4, 0, 0, 0, 0, 1, 0.6, 0.4, 0.3, 0.2, 0.3, 0.2, 0, 0, 0, 1],
        [0.5, 0, 0, 0, 0, 1, 0.3, 0.4, 0.6, 0.25, 0.15, 0.2, 0, 0, 0, 1],
    )
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    head += [f"property float {word}" for word in words] + ["end_header", ""]
    path.write_bytes("\n".join(head).encode() + np.array(rows, "<f4").tobytes())


def _lobe(path: Path) -> None:
    """A measured material as RGL's files have it: a diffuse one, isotropic, of a few numbers."""
    from mitsuba.python import tensor_io

    theta = np.linspace(0, np.pi / 2, 4, dtype=np.float32)
    each = np.ones((1, len(theta), 8, 8), np.float32)
    tensor_io.write(
        str(path),
        theta_i=theta,
        phi_i=np.zeros(1, np.float32),
        sigma=np.linspace(1, 0.2, 8, dtype=np.float32)[None].repeat(2, 0),
        ndf=np.ones((2, 8), np.float32),
        vndf=each,
        luminance=each,
        rgb=np.array([0.6, 0.4, 0.3], np.float32)[None, None, :, None, None]
        * np.ones((1, len(theta), 3, 8, 8), np.float32),
        description=np.frombuffer(b"matte", np.uint8),
        jacobian=np.zeros(1, np.uint8),
    )
