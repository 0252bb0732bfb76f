"""Photographs of a painted box by a ray caster in NumPy: nothing of isas, nor of Mitsuba."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

HALF = np.array([0.5, 0.4, 0.3])
SIZE, FOCAL = (80, 64), 90.0
_FINE = 3  # rays a side of each pixel
_SQUARE = (0, 0), (1, 0), (1, 1), (0, 1)


def cameras(count: int) -> list[np.ndarray]:
    """From camera to world, ``(4, 4)``, nerfstudio's axes: around the box, above and below it."""
    found = []
    for number in range(count):
        around, up = 0.3 + 2 * np.pi * number / count, (-0.5, 0.6)[number % 2]
        back = np.array([np.cos(around) * np.cos(up), np.sin(up), np.sin(around) * np.cos(up)])
        right = np.cross([0, 1, 0], back)
        right /= np.linalg.norm(right)
        place = np.eye(4)
        place[:3, :3] = np.column_stack([right, np.cross(back, right), back])
        place[:3, 3] = 2.2 * back
        found.append(place)
    return found


def seen(
    place: np.ndarray, scale: int = 1, lens: tuple[float, float, float] = (0, 0, 0)
) -> tuple[np.ndarray, np.ndarray]:
    """Linear colours over black ``(H, W, 3)``, and how much of each pixel the box fills. ``lens``:
    how far its principal point is from the picture's middle, pixels to the right and down, and k of
    r (1 + k r²)."""
    (width, height), focal = (n * scale for n in SIZE), FOCAL * scale
    steps = (np.arange(_FINE) + 0.5) / _FINE
    x = (np.arange(width)[:, None] + steps).ravel() - width / 2
    y = (np.arange(height)[:, None] + steps).ravel() - height / 2
    x, y = np.broadcast_arrays((x[None] - lens[0]) / focal, (y[:, None] - lens[1]) / focal)
    wanted = np.hypot(x, y)
    radius = wanted.copy()
    for _ in range(30):
        radius = wanted / (1 + lens[2] * radius**2)
    part = radius / np.maximum(wanted, 1e-12)
    rays = np.stack(np.broadcast_arrays(x * part, -y * part, -1.0), axis=-1)
    rays = rays @ place[:3, :3].T
    eye = place[:3, 3]
    near = (-np.sign(rays) * HALF - eye) / rays
    far = (np.sign(rays) * HALF - eye) / rays
    axis, at = near.argmax(axis=-1), near.max(axis=-1)
    hit = (at < far.min(axis=-1)) & (at > 0)
    point = (eye + rays * at[..., None]) / (2 * HALF) + 0.5
    face = 2 * axis + (np.take_along_axis(rays, axis[..., None], -1)[..., 0] < 0)
    cell = np.clip((point * 4).astype(int), 0, 3)
    number = face * 64 + cell @ [16, 4, 1]
    paint = np.random.default_rng(0).uniform(0.15, 0.8, (6 * 64, 3))
    # Of a face's own axis no cell counts.
    number -= np.take_along_axis(cell, axis[..., None], -1)[..., 0] * np.array([16, 4, 1])[axis]
    colours = np.where(hit[..., None], paint[np.clip(number, 0, None)], 0)
    shape = height, _FINE, width, _FINE
    return colours.reshape(*shape, 3).mean(axis=(1, 3)), hit.reshape(shape).mean(axis=(1, 3))


def encoded(linear: np.ndarray) -> np.ndarray:
    """sRGB of 8 bits."""
    low = linear * 12.92
    high = 1.055 * np.clip(linear, 1e-9, None) ** (1 / 2.4) - 0.055
    return np.uint8(np.rint(255 * np.clip(np.where(linear < 0.0031308, low, high), 0, 1)))


def photographed(
    folder: Path,
    count: int,
    outline: str,
    scale: int = 1,
    seed: int = 0,
    lens: tuple[float, float, float] = (0, 0, 0),
    focals: float | tuple[float, ...] = 1,
    exposures: tuple[float, ...] | None = None,
    turned: float = 0,
) -> None:
    """Writes a set with ``transforms.json``, and ``white.png``, its light. ``outline``: ``alpha``;
    ``masks``, white where the box fills all of a pixel, over a grey wall; or ``none``: over a wall
    of many colours.

    What the file does not tell: ``lens``, of ``seen``; ``focals``, what it says of the focal
    length, over the truth; ``exposures`` of the pictures; ``turned``: how far, pixels, its poses
    turn what is seen, in the root mean square along each axis of the picture."""
    (folder / "masks").mkdir(parents=True, exist_ok=True)
    frames, (width, height) = [], (n * scale for n in SIZE)
    rng = np.random.default_rng(seed)
    for number, place in enumerate(cameras(count)):
        colours, part = seen(place, scale, lens)
        colours = colours * (1 if exposures is None else exposures[number])
        if outline == "alpha":
            straight = encoded(colours / np.maximum(part, 1e-6)[..., None])
            pixels = np.dstack([straight, np.uint8(np.rint(255 * part))])
        else:
            wall = np.full(colours.shape, 0.4)
            for _ in range(60 if outline == "none" else 0):
                left, top = rng.integers(0, width), rng.integers(0, height)
                wide, high = rng.integers(6, 60, 2)
                wall[top : top + high, left : left + wide] = rng.uniform(0.02, 0.9, 3)
            pixels = encoded(colours + wall * (1 - part[..., None]))
        Image.fromarray(pixels).save(folder / f"{number}.png")
        if outline == "masks":
            mask = np.uint8(255 * (part > 0.99))
            Image.fromarray(mask).save(folder / f"masks/{number}.png")
        tilt = turned / (FOCAL * scale) * rng.normal(size=3) * [1, 1, 0]
        place = place.copy()
        place[:3, :3] = place[:3, :3] @ Rotation.from_rotvec(tilt).as_matrix()
        focal = FOCAL * scale * float(np.broadcast_to(focals, count)[number])
        frame = {"file_path": f"{number}.png", "transform_matrix": place.tolist(), "fl_x": focal}
        frames.append(frame)
    numbers = {"w": width, "h": height, "cx": width / 2, "cy": height / 2}
    (folder / "transforms.json").write_text(json.dumps(numbers | {"frames": frames}))
    Image.new("RGB", (16, 8), (255, 255, 255)).save(folder / "white.png")


def _quads() -> np.ndarray:
    """The corners of the faces, ``(6, 4, 3)``."""
    found = np.zeros((6, 4, 3))
    for face in range(6):
        axis, sign = divmod(face, 2)
        others = [k for k in range(3) if k != axis]
        found[face, :, axis] = HALF[axis] * (1, -1)[sign]
        found[face][:, others] = HALF[others] * (2 * np.array(_SQUARE) - 1)
    return found


def turned_mesh(path: Path, degrees: float, size: float, axis=(0.6, 0.7, -0.39)) -> np.ndarray:
    """Writes the box, turned about an axis through its middle and ``size`` times as large, as OBJ
    with texture coordinates, a tile a face; its corners ``(24, 3)``."""
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array(axis) / np.linalg.norm(axis))
    lines = []
    for face, quad in enumerate(_quads()):
        for a, b in _SQUARE:
            lines.append(f"vt {(face % 3 + a) / 3:.6f} {(face // 3 + b) / 2:.6f}")
        outward = np.cross(quad[1] - quad[0], quad[2] - quad[0]) @ quad[0] > 0
        order = range(1, 5) if outward else range(4, 0, -1)
        lines.append("f " + " ".join(f"{4 * face + k}/{4 * face + k}" for k in order))
    corners = size * turn.apply(_quads().reshape(-1, 3))
    placed = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in corners]
    path.write_text("\n".join(placed + lines) + "\n")
    return corners


def off(parameters: dict, corners: np.ndarray) -> tuple[float, float, float]:
    """Of ``corners`` after the pose that ``photos.pose`` found: degrees, share of the size, and
    scene units by which they are off the box."""
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    found = corners - middle
    for name, axis in zip("xyz", np.eye(3)):
        angle = np.radians(float(np.ravel(parameters[f"turn_{name}"])[0]))
        found = Rotation.from_rotvec(angle * axis).apply(found)
    found = found * 2 ** float(np.ravel(parameters["size"])[0]) + middle
    found = found + np.ravel(parameters["shift"])
    truth = _quads().reshape(-1, 3)
    one, other = found - found.mean(axis=0), truth - truth.mean(axis=0)
    u, s, v = np.linalg.svd(one.T @ other)
    turn = Rotation.from_matrix((u @ v).T)
    size = np.sum(one * one) / s.sum()
    shift = np.linalg.norm(found.mean(axis=0) - truth.mean(axis=0))
    return float(np.degrees(turn.magnitude())), float(size - 1), float(shift)
