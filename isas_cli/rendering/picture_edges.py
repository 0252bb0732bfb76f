"""Edges in photographs, and what the edges of a moving mesh say against them."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, sobel

from ..scene.problem import Problem
from ..scene.topology import Topology
from ..scene.views import Views
from ..unknowns.parameters import own
from .border import Border
from .outline import Cameras, Outline, at, crossed, draw, every, pair, pull, silhouettes, spans

# Directions of edges that are told apart, of half a turn; distances beyond which an edge in the
# picture is another one, at first and in the end, and the blur before they are found, in pixels.
_WAYS, _FAR, _NEAR, _BLUR = 8, 12.0, 3.0, 1.0
# Of a mesh: between the normals of two triangles that meet, from where on a picture shows an edge.
_CREASE = np.cos(np.radians(25.0))


def distances(pictures: Sequence[np.ndarray], masks: Sequence[np.ndarray]) -> np.ndarray:
    """Of each pixel of all views and each direction of an edge's normal, how far the nearest edge
    of about that direction is, pixels, at most ``_FAR``: ``(n _WAYS,) float32``.

    ``pictures (H, W, 3)``: linear; ``masks (H, W)``: 0 where a pixel says nothing. Edges as Canny
    (1986) finds them.
    """
    return np.concatenate([_distances(*each).ravel() for each in zip(pictures, masks)])


def _distances(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    from skimage.feature import canny

    grey = np.sqrt(np.clip(picture, 0, None).mean(axis=2))  # about as the eye sees it
    grey /= max(float(grey[mask > 0].max(initial=0)), 1e-12)
    found = canny(grey, sigma=_BLUR, mask=mask > 0)
    smooth = gaussian_filter(grey, _BLUR)
    angle = np.arctan2(sobel(smooth, axis=0), sobel(smooth, axis=1)) / np.pi * _WAYS
    result = np.full((*grey.shape, _WAYS), _FAR, np.float32)
    for way in range(_WAYS):
        apart = np.abs((angle - way + _WAYS / 2) % _WAYS - _WAYS / 2)
        like = found & (apart <= 1.5)
        if like.any():
            result[..., way] = np.minimum(distance_transform_edt(~like), _FAR)
    return result


class PictureEdges(Border):
    """Adds to the gradient of one mesh's vertices that of ``weight`` times

        E = 1/L ∫ min(d(q), D)² / D² dl(q)    over the visible silhouettes and creases of all views,

    q in pixels, L the length of all silhouettes and creases, hidden ones too, d(q) the distance of
    the nearest edge in the photograph whose direction is about the same (``distances``), D its
    largest: the model-based tracking of Drummond and Cipolla (2002), by distances as in chamfer
    matching (Barrow et al. 1977), at points drawn anew in every step. It asks for no light,
    material or background.

    Bias: the places on the mesh and L are held still, as is usual; slopes of d are over a pixel,
    which cuts its kinks (a tested case: 2.5 % less than differences).
    """

    def __init__(
        self, problem: Problem, topologies: dict[int, Topology], weight: float, samples: int,
        freeze: bool = True,
    ):  # fmt: skip
        super().__init__(problem, topologies, samples, 1)
        views, self._weight = len(problem.film_sizes), weight
        self._reach = [dr.opaque(mi.Float, 0), dr.opaque(mi.Float, 0)]
        self.narrow(0.0)

        def kernel(
            scene, sensors, films, positions, outline, cameras, targets, mask, seeds, _, maps,
            reach, factors,
        ):  # fmt: skip
            with dr.suspend_grad():
                now = dr.detach(positions)
                weights = _lengths(now, outline, cameras, films, views)
                drawn = draw(weights, outline, samples, seeds[0])
                # Of a crease no side is the object's: which way its normal points means nothing.
                point, _, _, crossing = crossed(now, outline, cameras, films, drawn)
                begin = cameras.begin(drawn.eye, point)
                ray = mi.Ray3f(begin, point - begin)
                ray.maxt = 1 - 1e-3
                valid = crossing.valid & ~scene.ray_test(ray, crossing.valid)
                turned = dr.atan2(crossing.away.y, crossing.away.x) * (_WAYS / dr.pi)
                way = mi.UInt32(turned + (2 * _WAYS + 0.5)) % _WAYS
                place = cameras.project(drawn.eye, point)

                def apart(x: float, y: float) -> mi.Float:
                    return _looked_up(maps, films, drawn.eye, place + mi.Point2f(x, y), way, valid)

                d = apart(0, 0)
                slope = mi.Vector2f(apart(0.5, 0) - apart(-0.5, 0), apart(0, 0.5) - apart(0, -0.5))
                # Drawn by length: each point stands for as much.
                far, share = reach
                counted = share * dr.gather(mi.Float, factors, drawn.eye)
                weight = dr.select(valid & (d < far), 2 * d * counted / samples, 0)
                dr.eval(weight, slope)
                pull(positions, cameras, drawn, slope, weight)

        self._made(
            kernel, freeze, problem.edges, self._reach, own(mi.Float, np.float32(self.factors))
        )

    def narrow(self, passed: float) -> None:
        """Set D for the share ``passed`` of the time in which edges alone are followed: what is far
        is drawn in first, and what is another edge left out then."""
        far = _FAR * (_NEAR / _FAR) ** min(passed, 1.0) - 0.5
        self._reach[:] = [dr.opaque(mi.Float, x) for x in (far, self._weight / far**2)]


def _looked_up(
    maps: mi.Float, films: Views, view: mi.UInt32, place: mi.Point2f, way: mi.UInt32, valid: mi.Bool
) -> mi.Float:
    """The distance at a point of the image, between the middles of pixels. Traced."""
    width, height = (dr.gather(mi.UInt32, each, view) for each in (films.width, films.height))
    x = dr.clip(place.x - 0.5, 0, mi.Float(width) - 1)
    y = dr.clip(place.y - 0.5, 0, mi.Float(height) - 1)
    column, row = mi.UInt32(x), mi.UInt32(y)
    right, down = x - mi.Float(column), y - mi.Float(row)

    def pixel(i: int, j: int) -> mi.Float:
        index = films.index(
            view, dr.minimum(column + i, width - 1), dr.minimum(row + j, height - 1)
        )
        return dr.gather(mi.Float, maps, index * _WAYS + way, valid)

    upper, lower = (dr.lerp(pixel(0, j), pixel(1, j), right) for j in (0, 1))
    return dr.lerp(upper, lower, down)


def _lengths(
    positions: mi.Float, outline: Outline, cameras: Cameras, films: Views, views: int
) -> mi.Float:
    """Of each edge in each view, its length in pixels if it is a silhouette or a crease and may lie
    in the image, else 0, ``(views E,)``. Traced."""
    edge, view = every(outline, views)
    ends = [at(positions, each) for each in pair(outline.ends, edge)]
    thirds = [at(positions, each) for each in pair(outline.across, edge)]
    along = ends[1] - ends[0]
    # Of the two faces, turned alike: seen along the edge one lies to its left.
    normals = [dr.normalize(dr.cross(along, thirds[0] - ends[0]))]
    normals.append(dr.normalize(dr.cross(thirds[1] - ends[0], along)))
    found = silhouettes(positions, outline, cameras.eyes, edge, view)
    found |= dr.dot(*normals) < float(_CREASE)
    return dr.select(found, spans(cameras, films, view, ends)[2], 0)


def of(pictures: Sequence[np.ndarray], masks: Sequence[np.ndarray]) -> mi.Float:
    """``distances`` as ``Problem.edges`` has them."""
    return own(mi.Float, distances(pictures, masks))
