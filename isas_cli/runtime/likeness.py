"""How alike two pictures are, over the pixels that count: PSNR, SSIM, FLIP.

All of pictures as a screen shows them, clip(linear, 0, 1) through the sRGB curve.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_erosion, gaussian_filter

from .images import srgb_encode

# Wang et al. 2004: a Gaussian of 1.5 pixels in a window of 11, and the constants of its Eq. 13.
_SIGMA, _RADIUS, _C1, _C2 = 1.5, 5, 0.01**2, 0.03**2
# Of pictures in a screen's unit: the share that is beyond white, at most, and what some reach.
_BEYOND, _DARK = 0.05, 0.05


def in_range(values: np.ndarray) -> bool:
    """Whether linear ``values`` of a picture are such as a screen shows: few beyond white, and not
    all nearly black. Photographs in floating point may be in another unit."""
    beyond = np.count_nonzero(values > 1)
    return bool(beyond <= _BEYOND * values.size and values.max(initial=0) >= _DARK)


def metrics(image: np.ndarray, target: np.ndarray, mask: np.ndarray) -> dict[str, float | None]:
    """``psnr`` (dB), ``ssim``, ``flip`` (None where the package flip-evaluator is not installed) of
    linear pictures ``(H, W, 3)`` over the pixels with a weight in ``mask (H, W)``, at least one."""
    chosen = mask > 0
    a, b = (srgb_encode(np.clip(np.nan_to_num(each), 0, 1)) for each in (image, target))
    error = float(np.mean((a - b)[chosen] ** 2))
    # What lies outside is nobody's: alike in both.
    a, b = (np.where(chosen[..., None], each, 0).astype(np.float32) for each in (a, b))
    return {
        "psnr": float("inf") if error == 0 else -10 * float(np.log10(error)),
        "ssim": _ssim(a, b, chosen),
        "flip": flip(a, b, chosen),
    }


def _ssim(a: np.ndarray, b: np.ndarray, chosen: np.ndarray) -> float:
    """The mean over channels and over pixels whose whole window counts, or where there are none,
    over all that do."""

    def mean(x: np.ndarray) -> np.ndarray:
        sides = (_SIGMA, _SIGMA, 0)
        return gaussian_filter(x.astype(np.float64), sides, radius=(_RADIUS, _RADIUS, 0))

    ma, mb = mean(a), mean(b)
    va, vb, vab = mean(a * a) - ma * ma, mean(b * b) - mb * mb, mean(a * b) - ma * mb
    found = (2 * ma * mb + _C1) * (2 * vab + _C2)
    found /= (ma * ma + mb * mb + _C1) * (va + vb + _C2)
    inside = binary_erosion(chosen, np.ones((2 * _RADIUS + 1,) * 2))
    return float(found[inside if inside.any() else chosen].mean())


def flip(a: np.ndarray, b: np.ndarray, chosen: np.ndarray) -> float | None:
    """Andersson et al. 2020, of displays at 67 pixels a degree: the mean over the ``chosen (H, W)``
    of two pictures in sRGB, ``(H, W, 3) float32``. None without the package flip-evaluator."""
    try:
        import flip_evaluator
    except ImportError:
        return None
    found, _, _ = flip_evaluator.evaluate(b, a, "LDR", inputsRGB=True, applyMagma=False)
    return float(np.asarray(found).reshape(chosen.shape)[chosen].mean())
