"""Mitsuba's own derivatives of whole images, as its users take them; blurred on request."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering import convex, rays, undone
from ..rendering.integrators import unattached
from ..rendering.own_film import OwnFilm
from ..rendering.projective import check_lamps, projective
from ..runtime import streams
from ..runtime.errors import InputError
from ..scene.problem import Problem
from ..unknowns import smoothing
from ..unknowns.blur import Blur
from ..unknowns.parameters import owner
from ..unknowns.ranges import only_emits
from .estimator import Estimator, Gradients, choice

# What ``silhouettes`` says to the projective integrator.
SILHOUETTES = {
    "octree": {"guiding": "octree"},
    "grid": {"guiding": "grid"},
    "uniform": {"guiding": "none"},
    "direct": {"sppi": 0},
}


@dataclass(frozen=True)
class Settings(Estimator):
    """``WholeImages``: Mitsuba's own derivative, by the scene's integrator, and where an unknown
    moves objects by ``prb_projective``. A baseline. ``silhouettes``: how those are sampled that are
    seen by way of other surfaces (shadows, reflections): octree (Mitsuba's default, by far the
    dearest), grid, uniform, or direct: not at all."""

    name: ClassVar[str] = "mitsuba"
    plannable: ClassVar[bool] = False
    draws: ClassVar[bool] = False

    silhouettes: str = "uniform"

    def __post_init__(self) -> None:
        super().__post_init__()
        choice("silhouettes", self.silhouettes, SILHOUETTES)

    def made(self, problem: Problem, loss) -> "WholeImages":
        return WholeImages(problem, loss, self.batch, silhouettes=self.silhouettes)

    def derivatives(self, problem: Problem) -> str:
        if problem.unknowns.moving:
            how = _silhouettes(problem, self.silhouettes)
            return f"Mitsuba's prb_projective on whole images, silhouettes: {how}"
        return f"Mitsuba's {problem.integrator.name} on whole images"


class WholeImages(Gradients):
    """dℒ/dθ by ``mi.render`` and ``dr.backward``: with the scene's own integrator, or, where an
    unknown moves objects, with ``prb_projective``, which samples silhouettes.

    ``smooth=None``: at θ itself, the baseline; an image at seed s for ∂ℒ/∂I, its derivative at
    another seed, both of ``spp`` paths a pixel (``batch`` shared out over all pixels, at least 1).

    ``smooth="image"`` or ``"loss"``: κ∂P (PRDPT Eq. 8), the mean over ``samples`` of the derivative
    at θ + τ, τ ~ κ. In image space ∂ℒ/∂I is taken at an independent τ' (without bias for
    dℒ(Q)/dθ, Q = κ ⋆ P, for losses of linear derivative); in loss space at the same τ (for
    ∂(κ ⋆ ℒ)/∂θ).

    Outside an unknown's range the derivative is 0, as values are clamped there.

    Bias: none where the integrator has none. ``prb_projective`` does not differentiate through
    ideally specular surfaces (glass, mirrors) that move. ``silhouettes``: how those are sampled
    that are seen by way of other surfaces (shadows, reflections): guided by an ``octree``
    (Mitsuba's default) or a ``grid``, both built anew each step and far dearer than all the rest
    of it, ``uniform``, or not at all (``direct``: those alone that the camera sees, which is biased
    where others move). Where one convex object is all there is, there are none, and it is
    ``direct``, whatever is asked for. The edge of a shadow that a light without extent throws (a
    point light) is not differentiated, however silhouettes are sampled: no traced ray meets such a
    light. What lies behind clear glass is reached by chance alone. What enters or leaves the image
    at its border is not differentiated. Nothing is frozen: projective integrators cannot be.

    The first estimate raises InputError where no derivative by any unknown is Mitsuba's.
    """

    def __init__(
        self,
        problem: Problem,
        loss,
        batch: int,
        smooth: str | None = None,
        samples: int = 1,
        silhouettes: str = "uniform",
    ):
        self.problem, self.loss, self.batch = problem, loss, batch
        self.smooth, self.samples = smooth, samples
        self.blur = Blur(problem, "estimator=plateau") if smooth else None
        self.blurs = smooth is not None
        _check_sensors(problem)
        if problem.views.altered:
            raise InputError(
                "estimator=mitsuba renders whole images as Mitsuba does, which knows no exposure "
                "and no other pose or lens of a view: take estimator=two_path, or "
                "photos.exposure=fixed, photos.refine=false, photos.lens=[] and files that give no "
                "exposures"
            )
        _check_shapes(problem)
        _warn(problem)
        self.integrator = _integrator(problem, silhouettes)
        self.spp = max(1, batch // problem.views.total)
        self._lost = dr.opaque(mi.UInt32, 0)
        self._sensors = [OwnFilm(sensor) for sensor in problem.scene.sensors()][: self._views]

    @property
    def nonfinite(self) -> int:
        """Pixels so far whose ∂ℒ/∂I was not finite. Waits."""
        return int(self._lost[0])

    @property
    def paths_per_step(self) -> int:
        """Light paths of one estimate; a sample of a silhouette counts as one, and those that a
        guide is built from do not."""
        # Where an image of its own says the residual, one path more carries the derivative.
        paths = 2 * self.spp + (self.smooth == "image")
        if self.problem.unknowns.moving:  # silhouettes that the camera sees, and others
            paths += self.spp * (1 if self.integrator.sppi == 0 else 2)
        return paths * self.problem.views.total * self.samples

    def estimate(self, values: dict, distribution, seed: int, iteration: int, spent: float) -> dict:
        """The gradient at ``values``, by key. ``distribution`` is not used: all pixels. Waits."""
        rng = np.random.default_rng(streams.seed(seed, iteration, "offset"))
        if self.smooth is None:
            self.problem.unknowns.attach(values)
            self._accumulate(None, rng)
            return self.problem.unknowns.gradients()
        θ = self.blur.vector(values)
        σ = self.blur.widths(θ, spent) * self.blur.moving(spent)
        total = np.zeros(θ.size)
        for _ in range(self.samples):
            at = θ + smoothing.blurred(σ, rng)
            images = None
            if self.smooth == "image":
                self.blur.write(θ + smoothing.blurred(σ, rng))
                images = [self._image(view, rng) for view in range(self._views)]
            self.problem.unknowns.attach(self.blur.clamped(at))
            self._accumulate(images, rng)
            found = self.blur.vector(self.problem.unknowns.gradients()) / self.samples
            # Beyond a range's end f(clamp(θ)) does not change.
            total += np.where(self.blur.inside(at), found, 0)
        return self.blur.values(total)

    @property
    def _views(self) -> int:
        return len(self.problem.film_sizes)

    def _image(self, view: int, rng: np.random.Generator) -> mi.TensorXf:
        """A view at the scene's present values, without derivatives. Evaluates."""
        with dr.suspend_grad():
            seed = int(rng.integers(1 << 32))
            p = self.problem
            how = p.integrator.mitsuba
            sensor = self._sensors[view]
            image = mi.render(p.scene, sensor=sensor, integrator=how, spp=self.spp, seed=seed)
            dr.eval(image)
        return image

    def _accumulate(self, images: list | None, rng: np.random.Generator) -> None:
        """Add to the leaves' gradients the derivative along ∂ℒ/∂I of ``images``, or of the images
        rendered on the way. Evaluates."""
        p = self.problem
        total = mi.Float(0)
        for view in range(self._views):
            seed, seed_grad = (int(x) for x in rng.integers(1 << 32, size=2))
            image = mi.render(
                p.scene,
                p.unknowns.params,
                sensor=self._sensors[view],
                integrator=self.integrator,
                # What is only differentiated need not be rendered well.
                spp=self.spp if images is None else 1,
                spp_grad=self.spp,
                seed=seed,
                seed_grad=seed_grad,
            )
            with dr.suspend_grad():
                found = dr.detach(image) if images is None else images[view]
                adjoint = self._adjoint(view, found)
            total += dr.sum(image.array * adjoint)
        # Once for all views: the first pass would clear the way from the scene to the leaves.
        try:
            dr.backward(total)
        except RuntimeError as error:
            if not unattached(error):
                raise
            raise InputError(_undone(p)) from error

    def _adjoint(self, view: int, image: mi.TensorXf) -> mi.Float:
        """∂ℒ/∂I of a view's pixels, ``(H W 3,)``."""
        p = self.problem
        width, height = p.film_sizes[view]
        first = sum(w * h for w, h in p.film_sizes[:view])
        pixel = dr.arange(mi.UInt32, width * height)
        target = dr.gather(mi.Color3f, p.targets, first + pixel)
        shown = dr.unravel(mi.Color3f, image.array)
        adjoint = rays.sound(self.loss.derivative(shown, target), shown) * p.share
        adjoint = rays.masked(adjoint, p.mask, first + pixel)
        whole = dr.all(dr.isfinite(adjoint))
        adjoint = dr.ravel(dr.select(whole, adjoint, 0))
        # Not read here: a step of the rival waits for nothing that it did not wait for before.
        self._lost += dr.count(~whole)
        dr.eval(adjoint, self._lost)
        return adjoint


def _check_sensors(problem: Problem) -> None:
    """Raises InputError for cameras whose silhouettes Mitsuba cannot sample."""
    for number, sensor in enumerate(problem.scene.sensors() if problem.unknowns.moving else ()):
        if sensor.class_name() != "PerspectiveCamera":
            raise InputError(
                f"sensor {number} is no perspective camera, and Mitsuba's derivative of what moves "
                f"('{problem.unknowns.moving[0]}') is for these alone: take estimator=plateau or "
                "estimator=finite_differences"
            )


def _check_shapes(problem: Problem) -> None:
    """Raises InputError for poses that move anything but shapes."""
    unknowns = problem.unknowns
    for name in unknowns.moving:
        for key in unknowns.written(name):
            if not isinstance(owner(unknowns.params, key), mi.Shape):
                raise InputError(
                    f"scene.unknowns['{name}'] moves '{key.rpartition('.')[0]}', which is no shape:"
                    " Mitsuba's derivative reaches shapes alone; take estimator=plateau with "
                    "estimator.gradient=kernel, or estimator=finite_differences"
                )


def _warn(problem: Problem) -> None:
    """Of unknowns by which Mitsuba's derivative is wrong (benchmarks/derivatives.md)."""
    lobes = problem.integrator.lobes
    wrong = {*(lobes.keys if lobes else problem.integrator.misses)}
    wrong |= {unknown.key for unknown in problem.unknowns if unknown.kind.aside}
    # What the scene's integrator misses two_path has not either.
    other = "sampler=finite_differences" if problem.integrator.misses else "estimator=two_path"
    told = (
        "Mitsuba's own derivative by "
        + ", ".join(f"'{key}'" for key in sorted(wrong))
        + f" is wrong (benchmarks/derivatives.md): compare with {other}"
    )
    if wrong and told not in problem.warnings:
        problem.warnings.append(told)


def _undone(problem: Problem) -> str:
    """That Mitsuba has no derivative by any unknown, and who has."""
    told = (
        f"scene.unknowns: Mitsuba does not differentiate by {undone.named(problem.unknowns.keys)}: "
        "take sampler=uniform estimator=two_path"
    )
    if not problem.integrator.misses:
        return told
    return f"{told}, without {undone.named_causes(problem.integrator)} in the scene"


def _integrator(problem: Problem, silhouettes: str) -> mi.Integrator:
    own = problem.integrator
    if only_emits(own.mitsuba):
        raise InputError(
            "estimator=mitsuba renders by Mitsuba's integrators, none of which has a medium that "
            "only emits and absorbs: take estimator=two_path"
        )
    if not problem.unknowns.moving:
        return own.mitsuba
    if "media" in own.simulates:
        raise InputError(
            "estimator=mitsuba: what moves is differentiated by prb_projective, which simulates no "
            f"media, and the scene's integrator is {own.name}: take estimator=plateau"
        )
    check_lamps(problem, "estimator=mitsuba")
    return projective(own, **SILHOUETTES[_silhouettes(problem, silhouettes)])


def _silhouettes(problem: Problem, asked: str) -> str:
    """How those are sampled that are seen by way of other surfaces, where there are any."""
    return "direct" if convex.alone(problem) else asked
