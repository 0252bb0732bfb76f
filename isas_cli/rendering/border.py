"""What all integrals over curves have in common at which the images step."""

from __future__ import annotations

from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene.problem import Problem
from ..scene.topology import Topology
from ..scene.views import Views
from ..unknowns.cameras import unknown
from . import rays
from .kernels import recorded
from .outline import Cameras, Crossing, Outline


class Border:
    """The edges of one mesh, and ``_kernel``, which adds one estimate by ``samples`` points on them
    to the gradient, each with ``paths`` light paths: with ``own`` as its last arguments, frozen or
    traced anew.

    ``topologies``: of the mesh, by the number of its vertices in the scene, where it becomes finer
    on the way.
    """

    # Whether nothing else says what cameras have to do with it: renderings that differ by them,
    # from which their derivative is else found, show edges as well.
    tells_cameras: ClassVar[bool] = False

    def __init__(self, problem: Problem, topologies: dict[int, Topology], samples: int, paths: int):
        self.problem, self.samples, self._paths = problem, samples, paths
        self.cameras = Cameras.of(problem)
        self._outlines = {count: Outline.of(each) for count, each in topologies.items()}

    @property
    def factors(self) -> np.ndarray:
        """How much each view counts, ``(V,)``."""
        given = self.problem.weights
        return np.ones(len(self.problem.film_sizes)) if given is None else given

    @property
    def edges(self) -> int:
        """How many, of the finest mesh."""
        return max(each.count for each in self._outlines.values())

    def _made(self, kernel, freeze: bool, *own) -> None:
        self._kernel, self._own = recorded(kernel, self.problem, freeze), own

    @property
    def paths_per_step(self) -> int:
        """Light paths of one estimate."""
        return self._paths * self.samples

    def accumulate(self, positions: mi.Float, seeds: list) -> None:
        """Add one estimate to the gradients of the mesh's ``positions``, the scene's attached ones
        where it moves, and of those of what else moves."""
        p = self.problem
        outline = self._outlines[dr.width(positions) // 3]
        self._kernel(
            p.scene, p.sensors, p.views, positions, outline, self._present(), p.targets, p.mask,
            seeds, p.share, *self._own,
        )  # fmt: skip

    def _present(self) -> Cameras:
        """The cameras as they are now."""
        unknowns, views, cameras = self.problem.unknowns, self.problem.views, self.cameras
        now = {field: getattr(views, field) for field in ("lens", "motion")}
        for each in unknown(unknowns) if self.tells_cameras else ():
            now[each.kind.field] = each.kind.attached(unknowns.leaves[each.key])
        if now["lens"] is not None:
            cameras = cameras.through(now["lens"], views.axes)
        if now["motion"] is not None:
            cameras = cameras.moved(now["motion"])
        return cameras


def residual(
    integrator, loss, scene, sensors, films: Views, targets, mask, share, crossing: Crossing,
    stream: mi.Sampler, paths: int,
) -> mi.Color3f:  # fmt: skip
    """∂ℒ/∂I of the pixels that are crossed, from ``paths`` paths through each, times the brightness
    of their views: steps of radiance are brighter by it in I. Traced."""
    radiance, place = mi.Color3f(0), (crossing.view, crossing.column, crossing.row)
    for _ in range(paths):
        radiance += rays.radiance(integrator, scene, sensors, films, place, stream)
    target = dr.gather(mi.Color3f, targets, crossing.pixel)
    adjoint = rays.sound(loss.derivative(radiance / paths, target), radiance) * share
    adjoint = rays.masked(adjoint, mask, crossing.pixel)
    adjoint *= films.brightness(crossing.view)
    return dr.select(crossing.valid, adjoint, 0)


def hidden_by_nothing(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> mi.Bool:
    """Whether ``ray`` meets nothing. Traced."""
    return ~scene.ray_test(ray, active)


def shown(
    scene: mi.Scene, cameras: Cameras, films: Views, si: mi.SurfaceInteraction3f,
    along: mi.Vector3f, inward: mi.Vector3f, valid: mi.Bool, random: mi.Sampler,
) -> tuple[Crossing, mi.Point3f, mi.Bool]:  # fmt: skip
    """Where one view, drawn uniformly, sees ``si``, through which a curve passes ``along``, the
    object ``inward`` of it; where the view's ray to it begins; and whether it does. Turns ``si.wi``
    to the view. Traced."""
    views = dr.width(cameras.eyes.finite)
    view = dr.minimum(mi.UInt32(random.next_1d() * views), views - 1)
    crossing = Crossing.of(cameras, films, view, si.p, along, inward, valid)
    begin = cameras.begin(view, si.p)
    valid = crossing.valid & hidden_by_nothing(scene, si.spawn_ray_to(begin), crossing.valid)
    si.wi = si.to_local(dr.normalize(begin - si.p))
    return crossing, begin, valid
