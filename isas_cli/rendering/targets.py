"""Target images: rendered from the truth at high sample count, or read from files."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config.schema import TargetConfig
from ..runtime import images
from ..runtime.cache import cached, digest, unfinished
from ..runtime.errors import InputError
from ..scene.problem import Problem
from . import black_box, rays, stratified
from .stratified import Sums

# Raised when what a cached target means changes.
_FORMAT = 4
# Times the noise that is wanted: more than this is said.
_MISSED = 1.05
# Pixels: of photographs no wider than this an object may well fill none.
_COARSE = 16
# Of a picture's pixels: fewer at the end of what its file can say pass for highlights.
_CLIPPED = 0.001


def render(
    problem: Problem, target: TargetConfig, told: Callable[[int, int], None]
) -> tuple[mi.Float, np.ndarray, str]:
    """Targets rendered at the truth as ``target`` says, from the cache where possible.

    ``told(done, total)`` counts light paths. Returns the images, the variance of each pixel
    ``(n,) float32`` (NaN where it is not known) and their content hash. What is there of a
    rendering that stops halfway is kept, and goes on.
    """
    wanted = target.wanted
    how = ["spp", target.spp] if wanted is None else ["noise", wanted]
    # What isas simulates in its place hangs on more than Mitsuba's integrator.
    simulated = type(problem.integrator).__name__
    if problem.integrator.black_box:
        how.append(black_box.FORMAT)
    what = problem.content_hash, simulated, *problem.unknowns.replaced()
    key = digest("target", _FORMAT, *what, how, target.seed, mi.__version__)
    name = f"target-{key}"
    if not problem.integrator.black_box:
        name += f"-{mi.variant()}"  # a GPU's are not a CPU's to the last bit

    def compute() -> dict[str, np.ndarray]:
        problem.unknowns.write(problem.unknowns.truths())
        with unfinished(f"{name}-part") as (part, keep):
            if problem.integrator.black_box:
                return black_box.rendered(problem, target, told, part, keep)
            begun = Sums.of(part) if part else None
            sums = stratified.render(
                *(problem, wanted, target.spp, target.seed, told, begun),
                keep=lambda sums: keep(sums.arrays),
            )
        found = {"images": sums.images, "variance": sums.variance}
        return found | {"lost": np.array(sums.lost), "paths": np.array(sums.paths)}

    arrays = cached(name, compute)
    lost, paths = int(arrays["lost"]), int(arrays["paths"])
    if lost:
        problem.warnings.append(f"{lost} of {paths} target paths were not finite: left out")
    has = stratified.noise(arrays["images"], arrays["variance"])
    if wanted is not None and has > _MISSED * wanted:
        problem.warnings.append(
            f"the targets' noise is {has:.2g} of their brightness, not target.noise={wanted}, "
            f"after {paths // problem.views.total} paths a pixel, the most: target.spp=N takes more"
        )
    return mi.Float(arrays["images"].reshape(-1)), arrays["variance"], key


def given(
    problem: Problem, pictures: Sequence[np.ndarray], masks: Sequence[np.ndarray], filled: bool
) -> None:
    """Take photographs ``(H, W, 3)`` and their weights ``(H, W)`` as the targets of ``problem``, in
    the sensors' order. ``filled``: pixels that surfaces do not fill have no weight.

    Raises InputError where no pixel is left in any view; a warning names views without one.
    """
    pixels = np.concatenate([each.reshape(-1) for each in pictures])
    mask = np.concatenate([each.reshape(-1) for each in masks])
    hashed = hashlib.blake2b(pixels.tobytes(), digest_size=16)
    if filled:
        mask = mask * _filled(problem)
    hashed.update(mask.tobytes())
    if problem.views.given is not None:
        hashed.update(np.array(problem.views.given).tobytes())
    ends = np.cumsum([width * height for width, height in problem.film_sizes])[:-1]
    empty = [n for n, part in zip(problem.names, np.split(mask, ends)) if not part.any()]
    if len(empty) == len(problem.names):
        if (width := max(width for width, _ in problem.film_sizes)) <= _COARSE:
            raise InputError(
                f"no photograph shows the object in a pixel that it fills: they are {width} pixels "
                "wide at most: take a larger photos.width"
            )
        raise InputError(
            "no photograph shows the object where a pixel counts: its place or scale is not the "
            "cameras', or masks are inverted (white counts): look at `isas photos DIR "
            "photos.mesh=FILE`"
        )
    problem.warnings += [f"view {name} does not show the object" for name in empty]
    problem.set_targets(mi.Float(pixels), mi.Float(mask), hashed.hexdigest())


def _filled(problem: Problem) -> np.ndarray:
    """1 for pixels whose corners and middle show a surface, else 0, ``(n,) float32``. Waits."""
    views = problem.views
    place = views.locate(dr.arange(mi.UInt32, views.total))
    found = mi.Bool(True)
    for x, y in ((0.5, 0.5), (0, 0), (0, 1), (1, 0), (1, 1)):
        ray, _ = rays.through(problem.sensors, views, *place, mi.Point2f(x, y), mi.Point2f(0.5))
        found &= problem.scene.ray_intersect_preliminary(ray).is_valid()
    return np.array(dr.select(found, mi.Float(1), 0), np.float32)


def load(
    problem: Problem, paths: Sequence[str], masks: Sequence[str] | None
) -> tuple[mi.Float, mi.Float | None, str]:
    """Targets (and masks) read from image files, one per sensor, in the sensors' order."""
    sizes = problem.film_sizes
    for name, files in (("scene.targets", paths), ("scene.masks", masks)):
        if files is not None and len(files) != len(sizes):
            raise InputError(
                f"{name} lists {_counted(len(files), 'file')} for "
                f"{_counted(len(sizes), 'sensor')}: one per sensor"
            )
    loaded = [images.load(Path(f), finite=masks is None) for f in paths]
    films = _films(problem)
    read = [_sized(p.image, f"target {f}", *each) for p, f, each in zip(loaded, paths, films)]
    problem.warnings += images.unheeded(paths, [p.doubt for p in loaded])
    problem.warnings += _blurred(paths, films)
    if grey := [str(each) for each in paths if images.grey(each)]:
        one = len(grey) == 1
        problem.warnings.append(
            f"{'target' if one else 'targets'} {', '.join(grey)} {'has' if one else 'have'} no "
            "colours: red, green and blue are each compared with that one channel, which is wrong "
            "where the view has colours, as of a film of pixel_format luminance: give it in rgb"
        )
    counts = [np.ones(image.shape[:2], np.float32) for image in read]
    mask = None
    if masks is not None:
        counts = [
            _sized(images.read_mask(Path(f)), f"mask {f}", *each) for f, each in zip(masks, films)
        ]
        mask = np.concatenate([m.reshape(-1) for m in counts])
        if not mask.sum() > 0:
            raise InputError("scene.masks hide every pixel: at least one must be above 0")
        for path, image, own in zip(paths, read, counts):
            images.check_finite(path, images.emptied(image) & (own > 0))
        problem.warnings += [
            f"mask {path} hides every pixel: its target counts for nothing"
            for path, own in zip(masks, counts)
            if not own.any()
        ]
    problem.warnings += _clear(problem, paths, loaded, counts) + _clipped(paths, loaded, counts)
    pixels = np.concatenate([r.reshape(-1) for r in read])
    hashed = hashlib.blake2b(pixels.tobytes(), digest_size=16)
    if mask is not None:
        hashed.update(mask.tobytes())
    device_mask = None if mask is None else mi.Float(mask)
    return mi.Float(pixels), device_mask, hashed.hexdigest()


def _clear(
    problem: Problem, paths: Sequence[str], loaded: list[images.Picture], counts: list[np.ndarray]
) -> list[str]:
    """Colours that are not multiplied by their alpha are, in place: what is not there is black, as
    where a rendering shows nothing. Says so where such pixels count; of those that are multiplied
    where a rendering shows a sky."""
    found, by = [], problem.integrator
    sky = problem.scene.environment() is not None and not (by.hide_emitters or by.black_box)
    for path, picture, own in zip(paths, loaded, counts):
        image, over = picture.image, images.multiplied(path)
        if over and not sky or (alpha := images.read_alpha(path)) is None:
            continue
        if over:
            # Mitsuba's prb has none either where it shows a sky.
            clear = (alpha <= 0) & ~image.any(axis=2)
        else:
            image *= alpha[..., None]
            clear = alpha < 1
            picture.brightest[clear] = 0
        if (own[clear] > 0).any():
            found.append(str(path))
    if not found:
        return []
    return [
        f"what is transparent in {', '.join(found)} counts as black, as where nothing is rendered: "
        "scene.masks leaves it out"
    ]


def _clipped(
    paths: Sequence[str], loaded: list[images.Picture], counts: list[np.ndarray]
) -> list[str]:
    """That light is lost, where pixels that count are as bright as their file can say."""
    found = []
    for path, picture, own in zip(paths, loaded, counts):
        if images.counted(path):
            share = float(np.mean((picture.brightest >= 1) & (own > 0)))
            found += [f"{path} ({share:.1%} of its pixels)"] if share > _CLIPPED else []
    if not found:
        return []
    return [
        f"targets are as bright as their files can say in {', '.join(found)}: where the scene is "
        "brighter that is cut off, and what makes it comes out too dark: give EXR, or scene.masks "
        "that hide it"
    ]


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _films(problem: Problem) -> list[tuple[tuple[int, int], mi.Film | None]]:
    """Of each view how large it is, and its film, but where pictures are another renderer's."""
    films = [sensor.film() for sensor in problem.scene.sensors()]
    if problem.integrator.black_box:
        films = [None] * len(films)
    return list(zip(problem.film_sizes, films))


def _blurred(paths: Sequence[str], films: list) -> list[str]:
    """Of targets that Mitsuba may have rendered with a film whose pixels are other means."""
    wide = [film.rfilter().class_name() for _, film in films if film is not None]
    wide = sorted({name for name in wide if name != "BoxFilter"})
    if not wide or all(map(images.counted, paths)):
        return []
    return [
        f"pixels are compared as means over their squares, and the films' filter is "
        f"{', '.join(wide)}: targets that were rendered with it are softer than that, and so is "
        'what is found: render them with <rfilter type="box"/>'
    ]


def _sized(image: np.ndarray, what: str, size: tuple[int, int], film) -> np.ndarray:
    height, width = image.shape[:2]
    if film is not None and (width, height) == tuple(film.size()) != size:
        x, y = film.crop_offset()
        raise InputError(
            f"{what} is {width}×{height} pixels, as the whole film, of which its sensor has a "
            f"window of {size[0]}×{size[1]}: cut that out, from {x}, {y} on"
        )
    if (width, height) != size:
        raise InputError(
            f"{what} is {width}×{height} pixels, its sensor {size[0]}×{size[1]}: resize one of them"
        )
    return image
