"""Whether masks and alpha are about the object: its points against what counts in each picture."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import (
    distance_transform_edt,
    label,
    map_coordinates,
    minimum_filter,
    uniform_filter,
)

from ...scenes.meshes import Surface

if TYPE_CHECKING:
    from .camera import Camera, Photograph

# Points of a surface that are looked for in each picture.
_POINTS = 4000
# A share of those in the picture below which masks are doubted, and one that inverted masks would
# have at least.
_DOUBTED, _INVERTED = 0.3, 0.8
# What an alpha or mask is at least, or at most, that is the same everywhere; and at least, where a
# pixel shows nothing else.
_FULL, _EMPTY, _WHOLE = 0.99, 0.01, 0.999
# A normal number's deviation, over its median; and how many of these are sure.
_NORMAL, _SURE = 1.4826, 3.0
# What most of a mask is that is not black; below, it holds labels, or 8 bits in a file of 16, not
# weights: VOC's have 1 for the object, and 255 for the rim that nobody labelled.
DARK = 0.25
# Of a picture's border, what an inverted mask fills at least.
_AROUND = 0.9
# By how much an object may be larger or smaller than alpha or masks show it. Where parts of
# it are crowded, or thin, extents differ by a tenth.
_SIZED = 1.3
# Beyond these it is in another unit, whatever masks seem to be; and a number that says enough.
_SPECK, _VAST, _MANY = 0.02, 10.0, 100.0
# Pixels: how near to a mask's border mixtures are, and how near to a pixel those must be whose
# colours it is mixed of, which differ by such a share of their brightness; by
# how much of that difference a mixture may be off; and of how many of the border's pixels that must
# tell something, so that the others need not.
_BORDER, _REACH, _CONTRAST, _MIXED, _TOLD = 1.5, 4.0, 0.1, 0.1, 0.2
# Where a mesh is larger or smaller by the same factor in all views, by how much at least, how many
# of these and of pixels, in views where it is so large; and views that are asked.
_LARGER, _FEWEST, _WIDER, _SMALL, _ASKED = 0.04, 4, 1.5, 20, 12
# Of a mask, what is middle grey; and of a picture's side, where a frame may be.
_MIDDLE, _FRAME = (0.4, 0.6), 6
_PHOTOGRAPHED = 0.85  # of a picture, at least, within such a frame; a disk fills 0.79 of a square
# Of a hole in a mask: pixels at least, and a share of what is filled; and of the views, in how many
# one is rare.
_HOLE, _RARE = (12, 2e-3), 1 / 3
# Pixels: of the squares in which colours at borders are looked for, and what around them decides:
# ``_REACH``, a mean's one pixel, and ``_BORDER``.
_PIECE, _HALO = 256, 8
_LARGE = 512  # pixels: finer pictures say no more of how deep a place lies inside


def scattered(surface: Surface) -> np.ndarray:
    """Points of a surface, evenly by its area, ``(_POINTS, 3)``; always the same."""
    return facing(surface)[0]


def facing(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """``scattered``, and the unit normals of the triangles there, as these are turned."""
    rng = np.random.default_rng(0)
    a, b, c = (surface.vertices[surface.faces[:, k]].astype(np.float64) for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    chosen = rng.choice(len(area), _POINTS, p=area / area.sum())
    u, v = rng.random((2, _POINTS, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    place = a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen]
    return place, (normal / np.maximum(area, 1e-30)[:, None])[chosen]


def labelled(photograph: "Photograph") -> str:
    """What a dark mask mostly is, in words."""
    white = photograph.white
    return f"half of what is not black is at most {white:.2g} of white ({white * 255:.3g} of 255)"


def inverted(part: np.ndarray) -> bool:
    """Whether a mask fills the border of its picture and not the middle. ``part``: how much of each
    pixel the object fills, -1 where nothing says it."""
    border = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
    border = border[border >= 0]
    high, wide = (number // 3 for number in part.shape)
    middle = part[high : 2 * high + 1, wide : 2 * wide + 1]
    around = border.size > 0 and (border > 0.5).mean() >= _AROUND
    return bool(around and (middle > 0.5).mean() < 0.5)


def framed(alpha: np.ndarray, given: np.ndarray) -> bool:
    """Whether a picture's ``alpha``, which is not whole, says what was photographed, and its mask
    ``given`` what the object is: but for a frame it is whole, as undistortion leaves it, within
    which the mask leaves something out, and the frame as well."""
    whole, inner = alpha >= _WHOLE, _inner(alpha)
    out = given <= 0.5
    return bool(whole[inner].all() and out[inner].any() and out[~whole].mean() > 0.5)


def whole(alpha: np.ndarray) -> bool:
    """Whether an ``alpha`` is whole but for a frame, as undistortion leaves it: then it says what
    was photographed, and nothing of an object. What fills a picture leaves its corners out."""
    kept = alpha >= _WHOLE
    return bool(kept[_inner(kept)].all() and kept.mean() >= _PHOTOGRAPHED)


def _inner(picture: np.ndarray) -> tuple[slice, slice]:
    """What of a picture lies within a frame that it may have."""
    (height, width), (high, wide) = picture.shape, (side // _FRAME for side in picture.shape)
    return slice(high, height - high), slice(wide, width - wide)


def unsure(given: np.ndarray) -> bool:
    """Whether a mask has, besides black and white, a broad band of one middle grey, as trimaps have
    where nobody knows what is the object."""
    middle = (given > _MIDDLE[0]) & (given < _MIDDLE[1])
    if not middle.any():
        return False
    grey = given == given[middle][0]
    return bool((grey | (given == 0) | (given == 1)).all() and minimum_filter(grey, 3).any())


def box(filled: np.ndarray) -> np.ndarray | None:
    """Where what is more than half ``filled`` begins and ends, ``(2, 2)``, as shares of the
    picture's width and height; None of nothing, of what reaches the border, and of all but a frame,
    as an alpha is that says what was photographed."""
    inside = filled > 0.5
    if not inside.any() or inside[_inner(inside)].all():
        return None
    sides = np.array(inside.shape[::-1])
    ends = np.transpose([np.flatnonzero(inside.any(axis=axis))[[0, -1]] for axis in (0, 1)])
    if (ends[0] == 0).any() or (ends[1] == sides - 1).any():
        return None
    return (ends + [[0], [1]]) / sides


def _pierced(part: np.ndarray) -> bool:
    """Whether what the object fills of a picture has holes of some size. ``part``: as of
    ``inverted``."""
    filled = (part > 0.5) | (part < 0)
    beside, _ = label(~filled)
    sizes = np.bincount(beside.ravel())
    # What is filled is 0.
    around = np.concatenate([beside[0], beside[-1], beside[:, 0], beside[:, -1], [0]])
    sizes[around] = 0
    return bool(sizes.max() >= max(_HOLE[0], _HOLE[1] * filled.sum()))


def empty(part: np.ndarray) -> bool:
    """Whether a picture shows nothing of the object. ``part``: how much of each pixel it fills."""
    return not (part > _EMPTY).any()


def softened(image: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much of each pixel the object fills, where masks of two values end it, and the picture of
    it over black. ``image (H, W, 3)``: linear; ``part (H, W)``: 0 or 1, as whole pixels say it.

    A pixel at the mask's border is taken for a mixture of the object and of what is behind it, of
    the colours nearest to it that are whole: I = α F + (1 - α) B. Where these are too far or too
    much alike to tell α, or it is no mixture of them, nothing is said of it, -1; where that is so
    nearly everywhere, the mask counts. Masks end half a pixel too soon or too late, as programs
    round, which an object's size shows.
    """
    picture, found = image * part[..., None], np.array(part, np.float32)
    border, known = (np.zeros(part.shape, bool) for _ in range(2))
    for around, place, inner in _pieces(part > 0.5):
        made = _mixtures(image[around], part[around])
        for whole, own in zip((picture, found, border, known), made):
            whole[place] = own[inner]
    if np.count_nonzero(known) > _TOLD * np.count_nonzero(border):
        found[border & ~known] = -1
    return picture, found


def _mixtures(image: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, ...]:
    """See ``softened``: the picture, how much the object fills, which pixels are at the border, and
    of which of these something is said."""
    inside = part > 0.5
    within, beyond = distance_transform_edt(inside), distance_transform_edt(~inside)
    front, some = _nearest(image, within > _BORDER)
    back, more = _nearest(image, beyond > _BORDER)
    unlike = front - back
    contrast = np.sum(unlike**2, axis=2)
    border = np.where(inside, within, beyond) <= _BORDER
    known = border & some & more
    known &= contrast > (_CONTRAST * np.maximum(front, back).sum(axis=2)) ** 2
    mixed = np.sum((image - back) * unlike, axis=2) / np.maximum(contrast, 1e-12)
    # Of other colours than those it is no mixture, or lies beyond them.
    beside = np.sum((image - back - mixed[..., None] * unlike) ** 2, axis=2)
    known &= (beside < _MIXED**2 * contrast) & (np.abs(mixed - 0.5) < 0.5 + _MIXED)
    found = np.where(known, np.clip(mixed, 0, 1), part).astype(np.float32)
    own = np.clip(image - (1 - found[..., None]) * back, 0, None)
    return np.where(known[..., None], own, image * part[..., None]), found, border, known


def over_black(image: np.ndarray, part: np.ndarray) -> np.ndarray:
    """The picture of an object over black, of which a soft mask says how much it fills of each
    pixel: what is behind it is taken away as it is beside it. As ``softened``."""
    picture = (image * part[..., None]).astype(np.float32)
    for around, place, inner in _pieces(part <= 0):
        own, filled = image[around], part[around]
        back, near = _nearest(own, filled <= 0)
        soft = (filled > 0) & (filled < 1) & near
        beside = np.clip(own - (1 - filled[..., None]) * back, 0, None)
        made = np.where(soft[..., None], beside, own * filled[..., None])
        picture[place] = made[inner]
    return picture


def _pieces(sides: np.ndarray) -> Iterator[tuple[tuple[slice, slice], ...]]:
    """Squares of a picture in or near which ``sides (H, W) bool`` changes: with what is around
    them, alone, and where they are in the first. Large pictures have few."""
    for corner in itertools.product(*(range(0, side, _PIECE) for side in sides.shape)):
        around = tuple(slice(max(0, at - _HALO), at + _PIECE + _HALO) for at in corner)
        own = sides[around]
        if own.any() and not own.all():
            inner = [at - both.start for at, both in zip(corner, around)]
            yield (
                around,
                tuple(slice(at, at + _PIECE) for at in corner),
                tuple(slice(at, at + _PIECE) for at in inner),
            )


def _nearest(image: np.ndarray, whole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each pixel the colour of the nearest that is ``whole``, a mean of those beside it, and
    whether it is near."""
    if not whole.any():
        return np.zeros_like(image), whole
    counts = uniform_filter(whole.astype(np.float64), 3)
    sums = [uniform_filter(np.where(whole, image[..., k], 0.0), 3) for k in range(3)]
    means = np.stack(sums, axis=2) / np.maximum(counts, 1e-9)[..., None]
    far, place = distance_transform_edt(~whole, return_indices=True)
    return means[tuple(place)], far <= _REACH


def doubts(
    photographs: "list[Photograph]", surface: Surface | None, begun: bool = False
) -> list[str]:
    """What should be said. ``begun``: whether the surface is but a beginning, of any size."""
    found = []
    full = [p for p in photographs if p.part is not None and (p.part[p.part >= 0] >= _FULL).all()]
    framed = [p for p in photographs if p.part is not None and whole(p.part)]
    full = framed if len(framed) == len(photographs) else full
    if full:
        found.append(
            f"photos.background=black: by alpha or masks the object fills all of {len(full)} of "
            f"{len(photographs)} pictures, first {full[0].camera.image}, but for a frame at most: "
            "if it does not, what is behind it counts as the object"
        )
    pierced = [p for p in photographs if p.part is not None and _pierced(p.part)]
    # A handle's hole is in many views.
    if pierced and len(pierced) <= _RARE * len(photographs):
        found.append(
            f"alpha or masks of {len(pierced)} of {len(photographs)} pictures have holes within "
            f"the object, first {pierced[0].camera.image}: if it has none there, fill them: shapes "
            "are cut through where they are"
        )
    dark = [p for p in photographs if p.white is not None and p.white < DARK]
    if dark:
        found.append(
            f"the masks of {len(dark)} of {len(photographs)} pictures, first "
            f"{dark[0].camera.mask}, hold several values, and {labelled(dark[0])}: labels, or 8 "
            "bits in a file of 16? Pixels count as much as they are white: save what counts as "
            "white"
        )
    masked = [
        p for p in photographs if p.part is not None or p.lost.get("masked by its file") is not None
    ]
    unknown = [p for p in photographs if p.unsure]
    if unknown:
        found.append(
            f"the masks of {len(unknown)} of {len(photographs)} pictures, first "
            f"{unknown[0].camera.mask}, have a broad band of middle grey, as trimaps have where "
            "nothing is known: it counts half or, where masks end the object, as the object: save "
            "masks of black and white"
        )
    if surface is None or not masked:
        return found
    points = scattered(surface)
    shares = [share for each in masked if (share := _met(each, points)) is not None]
    met = float(np.median(shares)) if shares else 1.0
    sizes = [] if begun else [_larger(each, points) for each in masked if each.part is not None]
    sizes = [size for size in sizes if size is not None]
    larger = float(np.median(sizes)) if sizes else 1.0
    told = f"of the object's points only {met:.0%} lie where they are white"
    inverted = met < _DOUBTED and np.median([1 - share for share in shares]) >= _INVERTED
    # Wrong units are no matter of masks.
    if inverted and _SPECK < larger < _VAST:
        found.append(f"masks look inverted: {told}, and white is what counts; or it lies elsewhere")
    elif not 1 / _SIZED < larger < _SIZED:
        off = max(larger, 1 / max(larger, 1e-9))
        off_by = f"{off:.2g}" if off < _MANY else f"more than {_MANY:g}"
        told = f"{off_by} times as {'large' if larger > 1 else 'small'}"
        found.append(
            f"the object is {told} in the pictures as alpha or masks show it there (median of "
            f"{len(sizes)} views): bring the mesh to the cameras' units; photos.pose=true finds "
            "its size where that is nearly right"
        )
    elif met < _DOUBTED:
        found.append(f"masks hide most of the object: {told}")
    return found


def larger(
    photographs: "list[Photograph]", cameras: "dict[str, Camera]", surface: Surface
) -> list[str]:
    """That the object is larger or smaller by some percent than alpha or masks show it, if it is so
    in all views, in width and in height alike. ``cameras``: as their file has them, by name."""
    logs, wide = [], []
    for each in photographs[:: -(-len(photographs) // _ASKED)]:
        camera = cameras[each.camera.name]
        place, depth = camera.project(surface.vertices)
        if each.box is None or not (depth > 0).all():
            continue
        sides = np.ptp(each.box, axis=0) * [camera.width, camera.height]
        if sides.min() >= _SMALL:
            logs.append(np.log(np.ptp(place, axis=0) / sides))
            wide.append(sides.mean())
    if len(logs) < _FEWEST:
        return []
    off = float(np.median(logs))
    spread = _NORMAL * float(np.median(np.abs(np.array(logs) - off)))
    least = max(_LARGER, _SURE * spread, _WIDER / np.median(wide))
    ended = any(each.part is not None for each in photographs)
    most = np.log(_SIZED) if ended else np.inf  # beyond, ``doubts`` says it
    if not least < abs(off) < most:
        return []
    how, why = ("larger", "end inside the object") if off > 0 else ("smaller", "hold more than it")
    return [
        f"the mesh is {abs(np.expm1(off)):.0%} {how} than alpha or masks show the object, in "
        f"width and in height, in {len(logs)} views alike: its size or the focal length is off "
        f"({'' if ended else 'photos.background=black with '}photos.pose=true or "
        f"photos.lens=[focal] finds it), or masks {why}"
    ]


def _met(photograph: "Photograph", points: np.ndarray) -> float | None:
    """The share of the object's points in the picture that lie where it counts; None of none."""
    place, _, inside = photograph.camera.seen(points)
    if not inside.any():
        return None
    column, row = place[inside].astype(int).T
    counts = photograph.mask if photograph.part is None else photograph.part
    return float((counts[row, column] > 0.5 * counts.max()).mean())


def _larger(photograph: "Photograph", points: np.ndarray) -> float | None:
    """How many times as long the object's points are in a picture as what alpha or mask shows of
    it, the geometric mean of both sides; infinite where the camera stands in it and its picture
    shows all of it; None where nothing is shown of it."""
    camera = photograph.camera
    size = np.array([camera.width, camera.height])
    place, depth = camera.project(points)
    shown = np.argwhere(photograph.part > 0.5)[:, ::-1] + 0.5
    met = ((place >= 0) & (place <= size)).all(axis=1) & (depth > 0)
    if not len(shown) or not met.any():  # it lies elsewhere
        return None
    if not (depth > 0).all():
        ends = (shown.min(axis=0) > 1).all() and (shown.max(axis=0) < size - 1).all()
        return np.inf if ends else None
    place = np.clip(place, 0, size)
    # Single points and pixels may lie anywhere.
    sides = [np.subtract(*np.percentile(each, (98, 2), axis=0)) for each in (place, shown)]
    if sides[1].min() < 2:
        return None
    sides[0] = np.maximum(sides[0], 1e-3)
    return float(np.sqrt(np.prod(sides[0] / sides[1])))


def within(
    photograph: "Photograph", points: np.ndarray, band: float, depths: tuple[np.ndarray, int]
) -> np.ndarray:
    """How deep points lie inside one outline, in scene units, within ``band``; ``band`` where the
    view says nothing. ``depths``: the ``signed`` ones of its pixels."""
    camera, (deep, by) = photograph.camera, depths
    place, depth, known = camera.seen(points)
    at = place[known][:, ::-1].T / by - 0.5
    seen = map_coordinates(deep, at, order=1, mode="nearest")
    found = np.full(len(points), band)
    found[known] = np.clip(seen * by * depth[known] / camera.fx, -band, band)
    return found


def signed(part: np.ndarray) -> tuple[np.ndarray, int]:
    """Of each pixel's middle, how many pixels it lies inside the outline, negative outside; of
    pixels that the object fills in part, by how much it fills them. Unknown ones are inside. Of
    large pictures made smaller, and by what."""
    filled = np.where(part < 0, 1.0, part)
    by = max(1, max(part.shape) // _LARGE)
    if by > 1:
        height, width = (n // by for n in part.shape)
        blocks = filled[: height * by, : width * by].reshape(height, by, width, by)
        filled = blocks.mean(axis=(1, 3))
    inside = filled >= 0.5
    if inside.all():
        return np.full(filled.shape, float(max(filled.shape))), by
    deep = distance_transform_edt(inside) - distance_transform_edt(~inside)
    deep -= np.sign(deep) * 0.5
    between = (filled > 0) & (filled < 1) & (np.abs(deep) < 1)
    return np.where(between, filled - 0.5, deep), by
