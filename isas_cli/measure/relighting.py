"""Scores of relighting and of what a surface was taken apart into, as Stanford-ORB's evaluation
counts them (Kuang et al. 2023), so that numbers compare with its tables.

Pictures are linear, ``(H, W, 3)``; ``mask (H, W)`` counts where it is above a half, without a rim
of two pixels. Under another light, and of base colours, a factor for each channel is fitted by
least squares first: light and colour trade brightness. Under the light of the photographs none is.
What the names do not tell:

- squares are averaged over all pixels, those outside the mask as black ones, so that a small object
  scores higher;
- the peak is 1, also where values are cut at 4; before that, pictures are brightened by how much
  brighter sRGB shows the target in the mean;
- a target of 8 or 16 bits was cut off at white, which ours are not: below that its factors are
  fitted, and it has no ``psnr_h``;
- no PSNR is below that of a picture of 0.5;
- ``flip`` is ours, of what ``psnr_l`` is of (``runtime.likeness``);
- ``normals`` is the mean of 1 − cos, 0 to 2. ``degrees``, the mean angle, is ours;
- chamfer is of squared distances. Points lie evenly on both surfaces; the benchmark takes the
  vertices of its scans for those of the truth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import binary_erosion, convolve1d
from scipy.spatial import cKDTree

from ..config.photographs import PhotosConfig
from ..runtime import images, likeness
from ..runtime.errors import InputError
from ..scene.photos import finding, transforms, turns
from ..scene.photos.base import load_json
from ..scene.photos.camera import Camera
from ..scene.photos.importing import resample
from ..scene.shape_error import Sampled

_RIM = np.ones((5, 5), bool)
_BRIGHTEST, _WHITE, _GREY = 4.0, 1.0, 0.5
# A window of 3 pixels, and the constants of Wang et al. 2004.
_WINDOW = np.exp(-(np.array([-1.0, 0.0, 1.0]) ** 2) / (2 * 1.5**2))
_C1, _C2 = 0.01**2, 0.03**2
_ENDINGS = (".exr", ".hdr", ".png")


def pictures(
    image: np.ndarray,
    target: np.ndarray,
    mask: np.ndarray,
    relit: bool = True,
    white: np.ndarray | None = None,
) -> dict[str, float | None]:
    """``psnr_h``, ``psnr_l`` (dB), ``ssim`` and ``flip`` of a rendering, ``relit``: under another
    light; ``in_range``: ``likeness.in_range`` of the target. ``white (H, W) bool``: where a target
    of whole numbers was cut off."""
    chosen = _inside(mask)
    known = chosen if white is None else chosen & ~white
    if relit and not known.any():
        raise Nothing("relighting: all that counts of its picture is white, which tells no factor")
    image, target = _cut(image, target, chosen)
    in_range = likeness.in_range(target[chosen])
    image = _fitted(image, target, known) if relit else image
    shown = np.clip(target, 0, _WHITE)
    brighter = 1.0 if shown.mean() <= 1e-8 else images.srgb_encode(shown).mean() / shown.mean()
    both = (np.clip(each * brighter, 0, _BRIGHTEST) for each in (image, target))
    encoded = [images.srgb_encode(np.clip(each, 0, _WHITE)) for each in (image, target)]
    return {
        "psnr_h": _psnr(*both, chosen) if white is None else None,
        "psnr_l": _psnr(*encoded, chosen),
        "ssim": _ssim(*encoded),
        "flip": likeness.flip(*(np.float32(each) for each in encoded), chosen),
        "in_range": in_range,
    }


def albedo(image: np.ndarray, target: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """``psnr`` (dB) and ``ssim`` of base colours, linear."""
    chosen = _inside(mask)
    image, target = _cut(image, target, chosen)
    both = [np.clip(each, 0, _WHITE) for each in (_fitted(image, target, chosen), target)]
    return {"psnr": _psnr(*both, chosen), "ssim": _ssim(*both)}


def normals(image: np.ndarray, target: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """``normals`` and ``degrees`` of normals ``(H, W, 3)``, of any length, in one frame."""
    a, b = (
        each / (np.linalg.norm(each, axis=2, keepdims=True) + 1e-6)
        for each in (np.float64(image), np.float64(target))
    )
    cosine = np.einsum("hwk,hwk->hw", a, b)[_inside(mask)]
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return {"normals": float(np.mean(1 - cosine)), "degrees": float(angle.mean())}


def chamfer(surface: Sampled, truth: Sampled) -> float:
    """The mean of both ways' mean squared distances between points of the surfaces."""
    ways = (surface, truth), (truth, surface)
    return sum(np.mean(cKDTree(a.points).query(b.points)[0] ** 2) for a, b in ways) / 2


def of_set(file: Path | str, folder: Path | str) -> dict[str, dict]:
    """``views``: ``pictures`` of every frame of ``file``, such as `transforms_novel.json`, by its
    name; ``mean``: of them. A frame with a ``scene_name`` is of the set of that name beside this
    one, and called after both. Renderings lie below ``folder`` under the frames' names, or the last
    part of them, as EXR, HDR or PNG. Pictures that are so many times as large are averaged. Masks
    are those that frames name, those of a folder that is called as the pictures' and ``_mask``, or
    the pictures' alpha.

    Raises InputError, naming the frame, for what is missing or of another size.
    """
    file, folder, views = Path(file), Path(folder), {}
    frames = load_json(file).get("frames")
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{file}: has no list of frames")
    for number, frame in enumerate(frames):
        where = f"{file}: frame {number}"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise InputError(f"{where} has no file_path")
        root, name = transforms.placed(file, frame)
        path = finding.picture(root, frame["file_path"], where, first=True)
        listed = finding.listed_mask(root, frame.get("mask_path"), f"{where}: mask_path")
        found = of_name(folder, name)
        if found is None:
            raise InputError(f"{folder}: no rendering of {name}, such as {Path(name).stem}.exr")
        shown = images.load(path, finite=False)
        white = _white(path, shown, PhotosConfig.saturated)
        mask = _mask(path, listed, where)
        views[name] = _scored(images.read(found), shown.image, mask, white, where)
    return {"views": views, "mean": mean(views)}


def of_picture(
    image: np.ndarray,
    rendering: Camera,
    camera: Camera,
    mask: Path | None,
    where: str,
    turned: bool,
    relit: bool,
    linear: bool | None = None,
    across: bool | None = None,
    saturated: float | None = PhotosConfig.saturated,
) -> dict[str, float | None]:
    """``pictures`` of what a ``rendering``'s camera sees, against the picture of the ``camera`` as
    its file has it, whose ``mask`` may be another file; where it is not ``relit`` as it was
    exposed. ``turned``: whether it is turned as its file asks; ``linear``: as ``images.load`` has
    it; ``across``: whether its mask lies otherwise (``turns.across``; None: if their sizes tell);
    ``saturated``: as ``photos.saturated``. Raises InputError, naming ``where``."""
    picture = images.load(camera.image, finite=False, linear=linear, turned=turned)
    fitting = _fitting(_mask(camera.image, mask, where, turned, across), picture.image)
    every = picture.image, fitting, _white(camera.image, picture, saturated)
    seen = (None if x is None else _seen(x, camera, rendering, where) for x in every)
    exposed = image if relit else image * np.float32(camera.exposure)
    return _scored(exposed, *seen, where, relit)


def _seen(pixels: np.ndarray, camera: Camera, rendering: Camera, where: str) -> np.ndarray:
    """A picture ``(H, W, 3)`` of a ``camera``, or its mask ``(H, W)``, as a ``rendering``'s camera
    sees it, where its own has a lens, or pixels that are not square; 0 where that shows nothing.
    Raises InputError for one of another shape than the camera's, whatever its size."""
    size = pixels.shape[1::-1]
    if turns.factor(size, (camera.width, camera.height)) is None:
        raise InputError(
            f"{where}: {size[0]} × {size[1]} pixels, but its camera is of {camera.width} × "
            f"{camera.height}, and no one factor of both axes is between them"
        )
    if camera.ideal or rendering.width > size[0]:  # the latter is refused as of all cameras
        return pixels
    colours = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)
    whole = np.ones(pixels.shape[:2], np.float32)
    found, known = resample(turns.scaled(camera, size), rendering, colours, whole)
    found *= known[..., None]
    return found if pixels.ndim == 3 else found[..., 0]


def _white(file: Path, picture: images.Picture, saturated: float | None) -> np.ndarray | None:
    """Where ``(H, W) float32`` a picture of whole numbers was cut off; None of others."""
    if not images.counted(file):
        return None
    return np.float32(picture.brightest >= np.float32(np.inf if saturated is None else saturated))


def _scored(
    image: np.ndarray,
    picture: np.ndarray,
    mask: np.ndarray,
    white: np.ndarray | None,
    where: str,
    relit: bool = True,
) -> dict:
    picture, mask = (_as_large(each, image, where) for each in (picture, mask))
    white = None if white is None else _as_large(white, image, where) > 0
    inside = _inside(mask)
    images.check_finite(where, ~np.isfinite(picture).all(axis=2) & inside)
    if not np.isfinite(image[inside]).all():
        raise Nothing(f"{where}: its rendering has pixels that are no numbers")
    return pictures(image, picture, mask, relit, white)


def mean(views: dict[str, dict]) -> dict[str, float | None]:
    """Of ``pictures`` by view, of those that have each."""
    found = {}
    for name in next(iter(views.values())):
        known = [view[name] for view in views.values() if view[name] is not None]
        found[name] = float(np.mean(known)) if known else None
    return found


def of_name(folder: Path, name: str) -> Path | None:
    """The picture in ``folder`` that is called as a view, or as the last part of its name."""
    for where in (folder / name, folder / Path(name).name):
        for ending in _ENDINGS:
            for found in (where.with_suffix(ending), where.with_name(f"{where.name}{ending}")):
                if found.is_file():
                    return found
    return None


def _mask(
    picture: Path,
    listed: Path | None,
    where: str,
    turned: bool = True,
    across: bool | None = None,
) -> np.ndarray:
    file = _mask_file(picture, listed)
    if file is not None:
        return turns.mask(file, picture, turned, across)
    alpha = images.read_alpha(picture, turned)
    if alpha is None:
        raise Nothing(f"{where}: no mask, nor alpha: what is not the object would count")
    return alpha


def masked(picture: Path, listed: Path | None) -> bool:
    """Whether anything says where the object is: a mask, ``listed`` or beside, or alpha."""
    return _mask_file(picture, listed) is not None or images.has_alpha(picture)


def _mask_file(picture: Path, listed: Path | None) -> Path | None:
    """That of a picture's mask, ``listed`` or beside, or None."""
    beside = picture.parent.with_name(f"{picture.parent.name}_mask") / f"{picture.stem}.png"
    return listed or (beside if beside.is_file() else None)


def _fitting(mask: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """A mask ``(H, W)`` of the picture's size, where it has another and the same shape."""
    size, wanted = mask.shape[1::-1], picture.shape[1::-1]
    if size == wanted or turns.factor(size, wanted) is None:
        return mask
    return np.asarray(Image.fromarray(mask).resize(wanted, Image.Resampling.BOX), np.float32)


def _as_large(pixels: np.ndarray, image: np.ndarray, where: str) -> np.ndarray:
    """Averaged to the size of ``image``. Raises InputError."""
    (height, width), (h, w) = pixels.shape[:2], image.shape[:2]
    if height % h or width % w:
        raise InputError(
            f"{where}: {w} × {h} rendered, which does not go into its {width} × {height}"
        )
    blocks = pixels.reshape(h, height // h, w, width // w, *pixels.shape[2:])
    return blocks.mean(axis=(1, 3))


class Nothing(InputError):
    """A view of which nothing can be scored."""


def _inside(mask: np.ndarray) -> np.ndarray:
    found = binary_erosion(mask > 0.5, _RIM, border_value=1)
    if not found.any():
        raise Nothing("relighting: nothing is left of its mask without a rim of two pixels")
    return found


def _cut(image: np.ndarray, target: np.ndarray, chosen: np.ndarray) -> list[np.ndarray]:
    """Both, black where not ``chosen``."""
    return [
        np.where(chosen[..., None], np.maximum(each, 0), 0).astype(np.float64)
        for each in (image, target)
    ]


def _fitted(image: np.ndarray, target: np.ndarray, known: np.ndarray) -> np.ndarray:
    """The image by the factors that bring it nearest where the target is ``known``."""
    seen = image * known[..., None]
    # A channel of nothing is fitted as if it were white, and stays black.
    white = np.where((seen**2).sum(axis=(0, 1)) > 1e-6, seen, known[..., None])
    return image * (white * target).sum(axis=(0, 1)) / (white**2).sum(axis=(0, 1))


def _psnr(image: np.ndarray, target: np.ndarray, chosen: np.ndarray) -> float:
    worst = np.mean((_GREY * chosen[..., None] - target) ** 2)
    error = min(np.mean((image - target) ** 2), worst)
    return float("inf") if error == 0 else float(-10 * np.log10(error))


def _ssim(a: np.ndarray, b: np.ndarray) -> float:
    def mean(x: np.ndarray) -> np.ndarray:
        weights = _WINDOW / _WINDOW.sum()
        return convolve1d(convolve1d(x, weights, axis=0, mode="mirror"), weights, 1, mode="mirror")

    ma, mb = mean(a), mean(b)
    va, vb, vab = mean(a * a) - ma * ma, mean(b * b) - mb * mb, mean(a * b) - ma * mb
    found = (2 * ma * mb + _C1) * (2 * vab + _C2)
    found /= (ma * ma + mb * mb + _C1) * (va + vb + _C2)
    # Of 1 − SSIM no value beyond 2 or below 0 is counted.
    return float(np.mean(np.clip(found, -1, 1)))
