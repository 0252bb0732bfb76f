"""How well views are foretold of which nothing was learnt."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..records import RunWriter
from ..rendering.renderer import Renderer
from ..runtime import images, likeness, streams
from ..scene.problem import Problem
from ..unknowns.exposure import Exposure
from ..unknowns.optics import Lens
from ..unknowns.parameters import as_numpy

_RGB = ["R", "G", "B"]
# Pictures of that many views are kept; all are measured.
_KEPT = 6
# Paths a pixel of what is scored, at least, whatever pictures take: their noise is in the scores.
_LEAST = 256
_NAMES = ("psnr", "ssim", "flip")


def measure(
    problem: Problem,
    values: dict,
    spp: int,
    seed: int,
    writer: RunWriter,
    given_up: Callable[[], bool] = lambda: False,
    told: Callable[[int, int], None] = lambda number, count: None,
) -> dict | None:
    """By view, PSNR, SSIM and FLIP of renderings at ``values`` with ``spp`` paths a pixel or
    ``_LEAST``, and their means; pictures go to frames/held_*. ``problem``: with the views held out.
    ``counted``: the share of a view's pixels that count, over which these are; ``scale``: what all
    are multiplied with before, 1 or, of photographs in another unit than a screen's, what brings
    their 99th percentile to white.

    Where exposures are unknown, a view's own is nowhere said: ``exposure`` is fitted to it by least
    squares, a factor or one for each channel.

    ``given_up``: asked before each view: ``left_out`` is how many it leaves out, and None is
    returned where these are all; ``told(number, count)``: which view, from 1, is begun of how many.
    """
    spp = max(spp, _LEAST)
    problem.unknowns.write(values)
    renderer = Renderer(problem)
    exposure = problem.unknowns.of(Exposure)
    channels = 0 if exposure is None else exposure.start.shape[1]
    masks = _per_view(problem)
    shown, views = [view for view, mask in enumerate(masks) if mask.any()], {}
    counting = np.array(problem.targets).reshape(-1, 3)[np.array(problem.mask) > 0]
    scale = 1.0 if likeness.in_range(counting) else images.exposure_for([counting])
    for number, view in enumerate(shown, 1):
        if given_up():
            break
        told(number, len(shown))
        name = problem.names[view]
        seeds = lambda s, v=view: streams.seed(seed, (v << 16) + s, "frame")
        image, target = renderer.view(view, spp, seeds), problem.target_image(view)
        factor = _fitted(image, target, masks[view], channels)
        image = (image * factor).astype(np.float32)
        views[name] = likeness.metrics(scale * image, scale * target, masks[view])
        views[name]["counted"] = float(np.mean(masks[view] > 0))
        if channels:
            views[name]["exposure"] = [float(x) for x in factor[:channels]]
        if view < _KEPT:
            frames = {"target": target, "result": image, "weight": masks[view]}
            for what, picture in frames.items():
                names = _RGB if picture.ndim == 3 else ["Y"]
                tags = {"what": f"held-out {what}", "view": name}
                writer.frame(f"held_{what}_v{view:02d}", picture, names, tags, None)
    if not views:
        return None
    found = {name: [v[name] for v in views.values() if v[name] is not None] for name in _NAMES}
    mean = {name: float(np.mean(each)) if each else None for name, each in found.items()}
    left = {"left_out": len(shown) - len(views)} if len(views) < len(shown) else {}
    return {"views": views, "mean": mean, "spp": spp, "scale": scale, **left}


def of_views(problem: Problem, values: dict) -> dict:
    """``exposure``: of each view of ``problem`` by name, where exposures are unknown, beside what
    the files say; ``lens``: of each by the name of its first view, ``Lens.told``."""
    exposure, lens = (problem.unknowns.of(kind) for kind in (Exposure, Lens))
    found = {}
    if exposure is not None and problem.names:
        found["exposure"] = dict(zip(problem.names, as_numpy(values[exposure.key]).tolist()))
    if lens is not None:
        found["lens"] = lens.kind.told(as_numpy(values[lens.key]))
    return found


def _per_view(problem: Problem) -> list[np.ndarray]:
    mask, found = np.array(problem.mask), []
    for width, height in problem.film_sizes:
        found.append(mask[: width * height].reshape(height, width))
        mask = mask[width * height :]
    return found


def _fitted(image: np.ndarray, target: np.ndarray, mask: np.ndarray, channels: int) -> np.ndarray:
    """The factor ``(3,)`` that brings the image nearest to its target."""
    if not channels:
        return np.ones(3)
    weight = mask[..., None].astype(np.float64)
    axes = (0, 1) if channels == 3 else (0, 1, 2)
    above, below = ((weight * image * x).sum(axis=axes) for x in (target, image))
    return np.broadcast_to(np.where(below > 0, above / np.where(below > 0, below, 1), 1), (3,))
