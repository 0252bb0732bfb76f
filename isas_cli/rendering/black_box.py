"""Pictures by a renderer that isas knows nothing of, as paths through their pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config.schema import TargetConfig
from ..runtime import interrupt, streams
from ..runtime.errors import InputError
from ..scene.lenses import Lenses
from ..scene.outside import Failed, Outside
from ..scene.problem import Problem
from ..unknowns.parameters import own
from .integrators import Integrator, Paths
from .stratified import noise

# Pictures of a view that targets are the means of: at first, and at most.
_FEWEST, _MOST = 4, 1024
# Raised when what is kept of them changes.
FORMAT = 2


@dataclass
class Places(Lenses):
    """Rays that say where in which picture a point is."""

    @staticmethod
    def of(views: int) -> "Places":
        numbers = own(mi.UInt32, np.zeros(views, np.uint32))
        return Places(own(mi.Float, np.zeros(1, np.float32)), numbers, numbers)

    def only(self, views: mi.UInt32) -> "Places":
        raise InputError("scene=external: its views are looked at all together")

    def rays(self, view, position, aperture):
        ray = dr.zeros(mi.RayDifferential3f, dr.width(position.x))
        ray.o, ray.d = mi.Point3f(position.x, position.y, mi.Float(view)), mi.Vector3f(0, 0, 1)
        return ray, mi.Color3f(1)


class BlackBox(Integrator):
    """All of a call's paths are of one picture: what is to be independent, is traced in calls of
    its own. A picture is asked for with a seed that the paths' own random numbers give. Waits, and
    cannot be recorded."""

    simulates = ()
    has_forward = samples_lights = False
    black_box = True
    derivatives = "none: pictures of another renderer"
    max_depth, hide_emitters = 1, False

    def __init__(self, outside: Outside):
        self.outside = outside
        self.paths = Paths(1, 1)

    @property
    def name(self) -> str:
        return self.outside.where

    def primal(self, scene, sampler, ray) -> tuple[mi.Color3f, None]:
        seed = int(sampler.next_1d()[0] * (1 << 24))
        view, (width, height) = mi.UInt32(ray.o.z), self.outside.sizes[0]
        pictures = np.zeros((len(self.outside.sizes), height, width, 3), np.float32)
        for number in np.flatnonzero(np.bincount(np.array(view))):
            pictures[number] = self.outside.picture(int(number), seed)
        column = dr.minimum(mi.UInt32(ray.o.x * width), width - 1)
        row = dr.minimum(mi.UInt32(ray.o.y * height), height - 1)
        found = own(mi.Float, pictures.ravel())
        return dr.gather(mi.Color3f, found, (view * height + row) * width + column), None

    def backward(self, scene, sampler, ray, adjoint: mi.Color3f) -> None:
        raise NotImplementedError("a black box has no derivative")


def rendered(
    problem: Problem,
    target: TargetConfig,
    told: Callable[[int, int], None],
    part: dict[str, np.ndarray],
    keep: Callable[[Callable[[], dict]], None],
) -> dict[str, np.ndarray]:
    """Means of pictures at the truth, as many as ``target`` asks for: ``images (n, 3)``, and the
    ``variance (n,)`` of their pixels, NaN where it is not known. ``told`` counts pixels; ``part``,
    ``keep``: of ``runtime.cache.unfinished``."""
    outside = problem.integrator.outside
    wanted, noisy = target.wanted, outside.settings.noisy
    first, second, whole = (part.get(name, 0.0) for name in ("first", "second", "whole"))
    count = int(part.get("count", 0))

    def aim() -> int:
        if not noisy or wanted is None:
            return target.spp if noisy else 1
        if count < _FEWEST:
            return _FEWEST
        has = np.nan_to_num(noise(*_means(first, second, whole)))
        return min(_MOST, int(np.ceil(count * (has / wanted) ** 2)))

    while count < aim():
        drawn = streams.seed(target.seed, count, "target") >> 8  # 24 bits, as a step's
        views = range(len(outside.sizes))
        pixels = np.concatenate([outside.picture(v, drawn).reshape(-1, 3) for v in views])
        finite = np.isfinite(pixels).all(axis=1)
        pixels[~finite] = 0
        with interrupt.held():
            first = first + pixels.astype(np.float64)
            second = second + np.square(pixels, dtype=float)
            whole = whole + finite
            count += 1
        sums = {"first": first, "second": second, "whole": whole, "count": np.array(count)}
        keep(sums.copy)
        told(count * len(pixels), max(count, aim()) * len(pixels))
    if missing := int((whole == 0).sum()):
        raise Failed(
            f"{outside.where}: {missing} pixels are no numbers in any of {count} target pictures: "
            "give target.spp more"
        )
    images, variance = _means(first, second, whole)
    if not noisy:
        variance = np.zeros(len(images), np.float32)
    found = {"images": images, "variance": variance}
    paths = count * len(images)
    return found | {"lost": np.array(paths - int(whole.sum())), "paths": np.array(paths)}


def _means(first, second, whole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``whole (n,)``: how many of a pixel were finite."""
    images = first / np.maximum(whole, 1)[:, None]
    spread = np.maximum(second - first * images, 0).mean(axis=1)
    variance = np.where(whole > 1, spread / np.maximum(whole * (whole - 1), 1), np.nan)
    if (whole > 1).any():  # of one picture nothing tells it
        variance[whole <= 1] = np.nanmean(variance)
    return images.astype(np.float32), variance.astype(np.float32)
