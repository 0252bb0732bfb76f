"""A small figure with limbs, its vertices unknown, and brute-force derivatives of its loss."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import references
from isas_cli.scenes import kirby, meshes
from isas_cli.scenes.icosphere import icosphere
from scenes_for_tests import render_targets, without_targets

from isas_cli import losses
from isas_cli.config.schema import UnknownConfig
from isas_cli.estimators.silhouettes import ByShape, Settings
from isas_cli.rendering import rays
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.rendering.renderer import Renderer
from isas_cli.scene.problem import Problem

KEY = "figure.vertices"
# The start's sphere, changed to an egg smaller than the figure: what is convex throws no shadow on
# itself, whose edges would be left out.
EGG = 0.85 * np.array([1.0, 0.8, 1.1])
STEP = 0.008  # of differences: a fifth of a pixel
COUNT = 12  # of estimates
EXACT = 0.02  # what the step of the differences is wrong by


def agrees(found: np.ndarray, exact: np.ndarray, wrong: float = EXACT) -> bool:
    """Within three standard errors of both, and ``wrong``, what the differences' step adds."""
    error = math.hypot(*(each.std(ddof=1) / math.sqrt(len(each)) for each in (found, exact)))
    size = abs(exact.mean())
    print(f"{found.mean() / exact.mean():.3f} ± {error / size:.3f} of the differences")
    return abs(found.mean() - exact.mean()) < 3 * error + wrong * size


def covered(p: Problem, fine: int) -> np.ndarray:
    """How much of each pixel surfaces cover now, by a grid of ``fine`` × ``fine`` rays each."""
    each = fine**2
    place = p.views.locate(dr.repeat(dr.arange(mi.UInt32, p.views.total), each))
    number = dr.tile(dr.arange(mi.UInt32, each), p.views.total)
    point = (mi.Point2f(number % fine, number // fine) + 0.5) / fine
    ray, _ = rays.through(p.sensors, p.views, *place, point, mi.Point2f(0.5))
    hit = dr.select(p.scene.ray_test(ray), mi.Float(1), 0)
    return np.array(dr.block_sum(hit, each), np.float64) / each


def shaped(vertices: np.ndarray, faces: np.ndarray, id: str = "figure", colour=kirby.COLOUR):
    """A matt mesh of smooth normals, its triangles apart as in a file with seams everywhere."""
    apart = meshes.from_corners(
        vertices[faces], np.zeros((0, 2)), meshes.corner_normals(vertices, faces)
    )
    matt = {"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}}
    return meshes.shape(id, apart, matt)


def problem(
    views: int = 3,
    side: int = 32,
    seams: bool = False,
    level: int = 3,
    start: str = "sphere",
    levels: int = 1,
    **more,
) -> Problem:
    """``seams``: no triangle shares a vertex in the file. ``levels``: as in ``scene.unknowns``.
    ``more``: beside the figure, or instead of it."""
    description = kirby.build(views, side, level) | more
    if seams:
        values = mi.traverse(description["figure"])
        vertices = np.array(values["vertex_positions"]).reshape(-1, 3)
        faces = np.array(values["faces"]).reshape(-1, 3)
        places, which = np.unique(vertices, axis=0, return_inverse=True)
        description["figure"] = shaped(places, which.ravel()[faces])
    made = without_targets(description, {KEY: UnknownConfig(start=start, levels=levels)})
    render_targets(made, 256)
    return made


def screened(sensor: dict, distance: float = 0.1) -> dict:
    """A screen before all that ``sensor`` sees, which its near clip plane cuts away."""
    matrix = np.array(sensor["to_world"].matrix).reshape(4, 4)
    place = mi.ScalarTransform4f(matrix).translate([0, 0, distance]).scale(distance)
    clipped = sensor | {"near_clip": 2 * distance}
    return {"screen": {"type": "rectangle", "to_world": place}, "sensor_000": clipped}


def egg(p: Problem) -> np.ndarray:
    """Where derivatives are taken."""
    return (p.unknowns[KEY].start * EGG).astype(np.float32)


def directions(x: np.ndarray) -> dict[str, np.ndarray]:
    """Movements of the vertices: of all, of their distance from the middle, of the top."""
    bump = np.exp(-np.sum((x - [0, 0.7, 0]) ** 2, axis=1) / 0.15)
    return {
        "right": np.broadcast_to([1.0, 0, 0], x.shape),
        "up": np.broadcast_to([0, 1.0, 0], x.shape),
        "scale": x,
        "bump": x * bump[:, None],
    }


def estimates(
    p: Problem,
    count: int,
    batch: int = 1 << 14,
    at: np.ndarray | None = None,
    ways: dict[str, np.ndarray] | None = None,
    **settings,
) -> dict[str, np.ndarray]:
    """By direction, ``ways`` or the usual ones, the derivative of the loss along it, estimated
    ``count`` times."""
    chosen = Settings(**{"batch": batch, "edges": batch, "shadows": batch} | settings)
    estimator: ByShape = chosen.on(p, losses.L2())
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    x = egg(p) if at is None else at
    values = p.unknowns.values_of({KEY: x})
    gradients = [
        np.array(estimator.estimate(values, uniform, 1, i, 0.0)[KEY], np.float64)
        for i in range(count)
    ]
    p.unknowns.write(values)
    return {
        name: np.array([np.sum(g * way) for g in gradients])
        for name, way in (ways or directions(x)).items()
    }


def differences(
    p: Problem,
    names: list[str] | None = None,
    spp: int = 512,
    at: np.ndarray | None = None,
    ways: dict[str, np.ndarray] | None = None,
    step: float = STEP,
) -> dict[str, np.ndarray]:
    """The same by central differences of the images, at the mean image's ∂ℒ/∂I: four estimates.
    ``names``: of ``ways``, or of the usual ones, those that count; None for all. Kept where they
    are known (``references``)."""
    x = egg(p) if at is None else at
    ways = ways or directions(x)
    names = list(names or ways)
    mask = [] if p.mask is None else p.mask
    of = [p.targets, mask, x, spp, step, *(ways[name] for name in names)]
    rows = references.known(
        "differences", of, lambda: np.array(_differenced(p, x, [ways[n] for n in names], spp, step))
    )
    return dict(zip(names, rows))


def _differenced(p: Problem, x: np.ndarray, ways: list, spp: int, step: float) -> list:
    renderer = Renderer(p)

    def image(at: np.ndarray, first: int) -> np.ndarray:
        p.unknowns.write(p.unknowns.values_of({KEY: at.astype(np.float32)}))
        found = renderer.range(0, p.views.total, spp, lambda i: first + i)
        return found.astype(np.float64)

    target = np.array(p.targets, np.float64).reshape(-1, 3)
    adjoint = 2 * (image(x, 5) - target) * float(p.share[0])
    if p.mask is not None:
        adjoint *= np.array(p.mask)[:, None]
    found = []
    for way in ways:
        firsts = (10**6 * (i + 1) for i in range(4))
        changes = (image(x + way * step, f) - image(x - way * step, f) for f in firsts)
        found.append([np.sum(adjoint * change) / (2 * step) for change in changes])
    return found


def ball(level: int = 2, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = icosphere(level)
    return radius * vertices, faces
