"""Gradients other than path replay's: which, and where they look."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import ClassVar

from ..config.schema import MOST_LANES
from ..estimators.mitsuba import SILHOUETTES, Stock
from ..runtime.errors import InputError
from ..unknowns.blur import Blur
from .differences import Differences
from .gradient import Gradient
from .sampler import Sampler
from .uniform import Uniform


def _choice(name: str, value: str, valid: Iterable[str]) -> None:
    if value not in valid:
        raise InputError(f"sampler.{name}={value}: valid: {', '.join(valid)}")


@dataclass
class Other(Sampler):
    """Base of gradients other than path replay's. Where they look is another's business: ``base``
    draws the pixels."""

    uses: ClassVar[frozenset[str]] = frozenset()
    replays: ClassVar[bool] = False
    spp: ClassVar[int] = 1  # paths of a drawn pixel in a rendering, where there is no setting

    base: Sampler = field(default_factory=Uniform)

    def __post_init__(self) -> None:
        super().__post_init__()
        if type(self.base) not in (Uniform, Gradient, Differences):
            name = type(self.base).__name__.lower()
            raise InputError(
                f"sampler.base={name}: it looks at derivatives of the paths, which are not taken "
                "here; valid: uniform, gradient, differences"
            )

    @property
    def looking(self) -> Sampler:
        return self.base

    def prepare(self, problem, loss, batch: int, freeze: bool = True) -> None:
        if 2 * batch * self.spp > MOST_LANES:
            raise InputError(
                f"sampler.spp={self.spp} times estimator.batch={batch}: at most {MOST_LANES // 2} "
                "paths a rendering"
            )
        # By paths, as a look's cost is to be that of a few steps.
        self.base.prepare(problem, loss, batch * self.spp, freeze)


@dataclass
class Plateau(Other):
    """Plateau-reduced gradients (PRDPT): of the objective blurred over the unknowns.

    ``gradient``: kernel (∂κP, Eq. 9: plain renderings, the kernel's derivative) or renderer (κ∂P,
    Eq. 8: Mitsuba's derivative at blurred values). ``smooth``: image (the paper's equation) or loss
    (its public code); ``scheme``: joint or separate; ``pairs``: of renderings, a step; ``spp``:
    paths of each drawn pixel in each rendering of a pair; ``common``: the same random numbers for
    both of a pair; ``residual``: from a pair of renderings too, or from one (the paper's), with
    ``residual_spp`` paths of each drawn pixel. See ``estimators.plateau``. ``silhouettes``: as in
    ``Mitsuba``.
    """

    gradient: str = "kernel"
    smooth: str = "image"
    scheme: str = "joint"
    pairs: int = 1
    spp: int = 1
    common: bool = True
    residual: str = "pair"
    residual_spp: int | None = None
    silhouettes: str = "uniform"

    def __post_init__(self) -> None:
        super().__post_init__()
        _choice("silhouettes", self.silhouettes, SILHOUETTES)
        _choice("gradient", self.gradient, ("kernel", "renderer"))
        _choice("smooth", self.smooth, ("image", "loss"))
        _choice("scheme", self.scheme, ("joint", "separate"))
        _choice("residual", self.residual, ("pair", "one"))
        for name, usual in (("residual", "pair"), ("residual_spp", None)):
            given = getattr(self, name)
            if given != usual and (self.smooth == "loss" or self.gradient == "renderer"):
                raise InputError(
                    f"sampler.{name}={given}: only sampler.smooth=image with "
                    "sampler.gradient=kernel has a residual of its own; leave it out"
                )
        if self.residual_spp is not None and (self.residual_spp < 2 or self.residual_spp % 2):
            raise InputError(
                f"sampler.residual_spp={self.residual_spp}: even, at least 2: half of them go to "
                "either rendering"
            )
        _at_least_one(self, "pairs", "spp")
        if self.gradient == "renderer":
            for name, usual in (("scheme", "joint"), ("common", True), ("spp", 1)):
                if getattr(self, name) != usual:
                    raise InputError(
                        f"sampler.{name}={getattr(self, name)}: the renderer's derivative has no "
                        "pairs of drawn pixels; leave it out (paths a pixel follow from "
                        "estimator.batch), or take sampler.gradient=kernel"
                    )
            _whole_images(self.base, "sampler.gradient=renderer")
        elif self.silhouettes != "uniform":
            raise InputError(
                f"sampler.silhouettes={self.silhouettes}: only sampler.gradient=renderer "
                "differentiates silhouettes; leave it out"
            )

    def prepare(self, problem, loss, batch: int, freeze: bool = True) -> None:
        if isinstance(self.base, Differences):
            self.base.follow(Blur(problem, "sampler=plateau"), self.smooth)
        super().prepare(problem, loss, batch, freeze)

    def estimator(self, problem, loss, batch: int, freeze: bool = True):
        if self.gradient == "renderer":
            return Stock(problem, loss, batch, self.smooth, self.pairs, self.silhouettes)
        from ..estimators.plateau import Plateau as Estimator

        settings = self.smooth, self.scheme, self.pairs, self.common
        more = {"spp": self.spp, "residual": self.residual, "residual_spp": self.residual_spp}
        return Estimator(problem, loss, batch, *settings, freeze, **more)


@dataclass
class Mitsuba(Other):
    """Mitsuba's own derivative of whole images: ``prb``, and where an unknown moves objects
    ``prb_projective``. A baseline. ``silhouettes``: how those are sampled that are
    seen by way of other surfaces (shadows, reflections): octree (Mitsuba's default, by far the
    dearest), grid, uniform, or direct: not at all."""

    silhouettes: str = "uniform"

    def __post_init__(self) -> None:
        super().__post_init__()
        _choice("silhouettes", self.silhouettes, SILHOUETTES)
        _whole_images(self.base, "sampler=mitsuba")

    def estimator(self, problem, loss, batch: int, freeze: bool = True):
        return Stock(problem, loss, batch, silhouettes=self.silhouettes)


@dataclass
class FiniteDifferences(Other):
    """Central differences of the loss along each unknown, with common random numbers. A baseline.
    ``step``: in widths of the unknown's last blur; ``spp``: paths of each drawn pixel in each
    rendering."""

    step: float = 1.0
    spp: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.step < math.inf:
            raise InputError(f"sampler.step={self.step}: must be a finite number above 0")
        _at_least_one(self, "spp")

    def estimator(self, problem, loss, batch: int, freeze: bool = True):
        from ..estimators.finite_differences import FiniteDifferences as Estimator

        return Estimator(problem, loss, batch, self.step, freeze, spp=self.spp)


def _at_least_one(sampler: Sampler, *names: str) -> None:
    for name in names:
        if getattr(sampler, name) < 1:
            raise InputError(f"sampler.{name}={getattr(sampler, name)}: at least 1")


def _whole_images(base: Sampler, where: str) -> None:
    if type(base) is not Uniform:
        raise InputError(f"{where} renders whole images: sampler.base must be uniform")
