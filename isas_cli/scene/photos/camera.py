"""One photograph and its camera, in one convention, whatever file it came from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...runtime.errors import InputError
from .lens import Lens

# Of a rotation: what is left of RᵀR - 1. Files round to four digits; a scale or a shear is larger.
_STRAIGHT = 2e-3
# What the names of instant-ngp's masks begin with.
HIDING = "dynamic_mask_"
# Squares are made of pixels up to this shape.
_OBLONG = 4


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera behind a lens.

    ``name``: of the view, as the file names its picture; ``image``, ``mask``: files (a mask is
    black where a pixel does not count, or None); ``width``, ``height``: pixels; ``fx``, ``fy``,
    ``cx``, ``cy``: pixels, counted from the picture's upper left *corner*, so that its first
    pixel's middle is (0.5, 0.5); ``lens``: what it does to the image plane; ``to_world``: ``(4,
    4)``, from camera to world, the camera's x to the right, y *down*, z *forward* (OpenCV's axes);
    ``exposure``: by how much its photograph is brighter than one at exposure 1, of each channel.

    Raises InputError, naming the view, for what is no camera.
    """

    name: str
    image: Path
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    to_world: np.ndarray
    mask: Path | None = None
    lens: Lens = Lens()
    exposure: tuple[float, ...] = (1.0, 1.0, 1.0)
    described: str = field(default="", repr=False)  # the file that says so

    def __post_init__(self) -> None:
        where = f"{self.described}: camera of {self.name}" if self.described else self.name
        numbers = [self.fx, self.fy, self.cx, self.cy]
        if not (np.isfinite(numbers).all() and np.isfinite(self.to_world).all()):
            raise InputError(f"{where}: holds NaN or infinite numbers: mend or remove this view")
        if self.lens.wrong:
            raise InputError(f"{where}: {self.lens.wrong}: mend or remove this view")
        if min(self.width, self.height) < 1:
            raise InputError(f"{where}: a picture of {self.width}×{self.height} pixels")
        if not min(self.fx, self.fy) > 0:
            raise InputError(f"{where}: focal length {min(self.fx, self.fy):g}: must be above 0")
        if max(self.fx, self.fy) > _OBLONG * min(self.fx, self.fy):
            raise InputError(
                f"{where}: focal lengths of {self.fx:g} and {self.fy:g} pixels: no lens has "
                f"pixels more than {_OBLONG} times as long as wide"
            )
        if self.to_world.shape != (4, 4) or not np.allclose(self.to_world[3], [0, 0, 0, 1]):
            raise InputError(f"{where}: its pose is no 4×4 matrix with a last row of 0, 0, 0, 1")
        turned = self.to_world[:3, :3]
        if np.linalg.det(turned) < 0:
            raise InputError(
                f"{where}: its axes are mirrored (determinant {np.linalg.det(turned):.3g}): an "
                "axis was flipped alone; flip two, or none"
            )
        off = np.abs(turned.T @ turned - np.eye(3)).max()
        if off > _STRAIGHT:
            raise InputError(
                f"{where}: its pose is no rotation (RᵀR differs from 1 by {off:.2g}): take scale "
                "and shear out of the matrix"
            )

    @property
    def hides(self) -> bool:
        """Whether its mask is the other way round, white where something moves that is not to
        count: instant-ngp's is, which says nothing of where the object ends."""
        return self.mask is not None and self.mask.name.startswith(HIDING)

    @property
    def centre(self) -> np.ndarray:
        """Where it stands, ``(3,)``, scene units."""
        return self.to_world[:3, 3]

    @property
    def ideal(self) -> bool:
        """Whether a renderer's pinhole camera is the same: square pixels, no distortion."""
        return self.fx == self.fy and self.lens.straight

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where points ``(N, 3)`` of the world are seen: ``(N, 2)`` pixels from the picture's upper
        left corner, and their depths ``(N,)``, negative behind the camera (where the pixel means
        nothing)."""
        rotation, place = self.to_world[:3, :3], self.centre
        inside = (np.asarray(points, np.float64) - place) @ rotation
        depth = inside[:, 2]
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        plane = self.lens.distort(inside[:, :2] / safe[:, None])
        return plane * [self.fx, self.fy] + [self.cx, self.cy], depth

    def seen(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """``project``, and which of the points lie before the camera and in its picture, ``(N,)
        bool``, whatever hides them."""
        place, depth = self.project(points)
        inside = (depth > 0) & (place >= 0).all(axis=1)
        return place, depth, inside & (place < [self.width, self.height]).all(axis=1)

    def pinhole(self, width: int | None = None) -> "Camera":
        """The camera without a lens and with square pixels that shows about the same, as wide as
        this one or ``width`` pixels."""
        wide = width or self.width
        focal = self.fx * wide / self.width
        down = focal / self.fy
        return replace(
            self,
            width=wide,
            height=max(1, round(self.height * down)),
            fx=focal,
            fy=focal,
            cx=self.cx * wide / self.width,
            cy=self.cy * down,
            lens=Lens(),
        )


@dataclass
class Photograph:
    """``camera``: the pinhole camera that it is resampled to; ``image (H, W, 3) float32``: linear;
    ``mask (H, W) float32``: weights of the pixels, 0 where it shows nothing that counts;
    ``lost``: why pixels do not count → how many of the photograph's own; ``doubt``: what its file
    says of its colours that could not be heeded, or None; ``variance``: of a pixel's noise, or None
    where the photograph does not tell (``noise.of_one``); ``part (H, W)``: how much of each pixel
    the object fills, where that counts (``photos.background=black``), -1 where nothing says it;
    ``white``: what most of its mask's file is that is not black, or None without one; ``unsure``:
    whether that has a broad band between (``outlines.unsure``); ``box``: of its alpha or, where
    that ends the object, mask (``outlines.box``), or None; ``edged``: the mask with the pixels that
    are saturated, which have edges, where these count (``photos.edges``)."""

    camera: Camera
    image: np.ndarray
    mask: np.ndarray
    lost: dict[str, int]
    doubt: str | None = None
    variance: float | None = None
    part: np.ndarray | None = None
    white: float | None = None
    unsure: bool = False
    box: np.ndarray | None = None
    edged: np.ndarray | None = None
