"""What a lens does to the image plane, by the models of OpenCV and COLMAP."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

_NONE = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Lens:
    """Where a point of the image plane at distance 1 is seen, on the same plane.

    First r is bent by the ``kind``, with its ``own`` numbers:
    ``flat``: not at all; ``fisheye``: θ = atan r (Kannala & Brandt 2006; its polynomial of θ is
    ``radial``); ``fov``: atan(2 r tan(ω/2)) / ω, ω radians (Devernay & Faugeras 2001);
    ``division``: the solution d of d = r (1 + k d²) (Fitzgibbon 2001); ``unified``:
    r / (α √(β r² + 1) + 1 - α) (Khomutenko et al. 2016).

    Then comes Brown's lens as OpenCV has it: (1 + k1 r² + k2 r⁴ + …) / (1 + k4 r² + k5 r⁴ + …)
    with the upper k in ``radial`` and the lower ones in ``below``; ``tangential``: p1, p2;
    ``prism``: s1 … s4; ``late``: whether these two see the radius after ``radial`` bent it, as in
    COLMAP's RAD_TAN_THIN_PRISM_FISHEYE; ``tilt``: τx, τy of the sensor, radians; ``skew``: how far
    x goes with y. All numbers are without unit.
    """

    radial: tuple[float, ...] = _NONE
    tangential: tuple[float, float] = (0.0, 0.0)
    below: tuple[float, ...] = ()
    prism: tuple[float, float, float, float] = _NONE
    tilt: tuple[float, float] = (0.0, 0.0)
    skew: float = 0.0
    late: bool = False
    kind: str = "flat"
    own: tuple[float, ...] = ()

    @property
    def numbers(self) -> tuple[float, ...]:
        """All of them."""
        more = self.prism + self.tilt + (self.skew,) + self.own
        return tuple(self.radial) + tuple(self.tangential) + tuple(self.below) + more

    @property
    def straight(self) -> bool:
        """Whether there is none: every point stays where it is."""
        return self.kind == "flat" and not any(self.numbers)

    @property
    def wrong(self) -> str | None:
        """What is impossible about it, or None."""
        if not np.isfinite(self.numbers).all():
            return "its lens holds NaN or infinite numbers"
        if self.kind == "fov" and not 0 < self.own[0] < np.pi:
            return f"omega {self.own[0]:g} of its lens: between 0 and π"
        if self.kind == "unified" and not (0 <= self.own[0] <= 1 and self.own[1] > 0):
            return f"alpha {self.own[0]:g}, beta {self.own[1]:g} of its lens: in [0, 1], above 0"
        return None

    @property
    def terms(self) -> dict[str, float]:
        """What is not 0 of its numbers, by OpenCV's names."""
        count = len(self.radial)
        names = [f"k{n + 1}" for n in range(count)] + ["p1", "p2"]
        # OpenCV counts the lower ones on from its three upper ones.
        names += [f"k{n + 4}" for n in range(len(self.below))]
        names += ["s1", "s2", "s3", "s4", "τx", "τy", "skew"]
        names += {"fov": ["ω"], "division": ["k"], "unified": ["α", "β"]}.get(self.kind, [])
        return {name: x for name, x in zip(names, self.numbers) if x}

    def __str__(self) -> str:
        """For a table."""
        if self.straight:
            return "none"
        told = [f"{name} {x:.3g}" for name, x in self.terms.items()]
        return ", ".join(([] if self.kind == "flat" else [self.kind]) + told)

    def distort(self, plane: np.ndarray) -> np.ndarray:
        """From the image plane at distance 1 without a lens, ``(…, 2)``, to that with it. Beyond
        ``reach`` it means nothing, but is finite."""
        x, y = plane[..., 0], plane[..., 1]
        if self.kind != "flat":
            factor = self._bend(np.hypot(x, y))
            x, y = x * factor, y * factor
        r2 = x * x + y * y
        stretched = _polynomial(self.radial, r2)
        if any(self.below):
            lower = _polynomial(self.below, r2)
            stretched = stretched / np.where(np.abs(lower) < 1e-9, 1e-9, lower)
        p1, p2 = self.tangential
        s1, s2, s3, s4 = self.prism
        bent_x, bent_y = x * stretched, y * stretched
        if self.late:
            x, y = bent_x, bent_y
            r2 = x * x + y * y
        bent_x = bent_x + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2)
        bent_y = bent_y + 2 * p2 * x * y + p1 * (r2 + 2 * y * y) + r2 * (s3 + r2 * s4)
        if any(self.tilt):
            bent_x, bent_y = self._tilted(bent_x, bent_y)
        return np.stack([bent_x + self.skew * bent_y, bent_y], axis=-1)

    def _bend(self, r: np.ndarray) -> np.ndarray:
        """By what the kind multiplies a point at radius r."""
        safe = np.maximum(r, 1e-12)
        if self.kind == "fisheye":
            return np.arctan(safe) / safe
        if self.kind == "fov":
            return np.arctan(2 * safe * np.tan(self.own[0] / 2)) / (safe * self.own[0])
        if self.kind == "division":
            return 2 / (1 + np.sqrt(np.maximum(1 - 4 * self.own[0] * r * r, 0)))
        alpha, beta = self.own
        return 1 / (alpha * np.sqrt(beta * r * r + 1) + 1 - alpha)

    def _tilted(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The sensor turned by τx about x, then by τy about y (Scheimpflug)."""
        (cx, cy), (sx, sy) = np.cos(self.tilt), np.sin(self.tilt)
        about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
        about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
        turned = about_y @ about_x
        straight = np.array(
            [[turned[2, 2], 0, -turned[0, 2]], [0, turned[2, 2], -turned[1, 2]], [0, 0, 1]]
        )
        a, b, c = straight @ turned
        depth = c[0] * x + c[1] * y + c[2]
        return (a[0] * x + a[1] * y + a[2]) / depth, (b[0] * x + b[1] * y + b[2]) / depth

    @cached_property
    def reach(self) -> float:
        """The radius on the plane without a lens up to which it keeps the order of points: beyond,
        its polynomial folds back or has a pole, and far points would be looked up inside the
        picture. Of ``tangential`` and what follows it, which is small, nothing is asked."""
        if self.kind == "division" and self.own[0] > 0:
            return float(0.5 / np.sqrt(self.own[0]))
        square = np.polynomial.Polynomial([0, 0, 1])
        upper = np.polynomial.Polynomial([1, *self.radial])(square)
        lower = np.polynomial.Polynomial([1, *self.below])(square)
        r = np.polynomial.Polynomial([0, 1])
        # Of r upper / lower, where its slope or what it is divided by is 0.
        slope = (r * upper).deriv() * lower - r * upper * lower.deriv()
        roots = [*slope.trim().roots(), *lower.trim().roots()]
        real = [root.real for root in roots if abs(root.imag) < 1e-9 and root.real > 0]
        most = min(real, default=np.inf)
        if self.kind == "fisheye":
            return float(np.tan(most)) if most < np.pi / 2 else np.inf
        return float(most)


def _polynomial(factors: tuple[float, ...], r2: np.ndarray) -> np.ndarray:
    """1 + k1 r² + k2 r⁴ + …"""
    found = np.zeros_like(r2)
    for factor in reversed(factors):
        found = r2 * (factor + found)
    return 1 + found


def of_opencv(numbers: tuple[float, ...], fisheye: bool = False) -> Lens:
    """OpenCV's distortion vector: k1, k2, p1, p2 [, k3 [, k4, k5, k6 [, s1 … s4 [, τx, τy]]]], or
    k1 … k4 of its ``fisheye``."""
    if fisheye:
        return Lens(radial=tuple(numbers), kind="fisheye")
    k1, k2, p1, p2, k3, *more = (*numbers, *(0.0,) * (14 - len(numbers)))
    return Lens(
        radial=(k1, k2, k3, 0.0),
        tangential=(p1, p2),
        below=tuple(more[:3]) if any(more[:3]) else (),
        prism=tuple(more[3:7]),
        tilt=tuple(more[7:]),
    )
