"""Where pictures lie, and their masks, besides where the cameras' file says."""

from __future__ import annotations

import os
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...config.photographs import PhotosConfig
from ...runtime import heif, images, raw
from ...runtime.errors import InputError
from .camera import HIDING, Camera

PLAIN = (".png", ".jpg", ".jpeg", ".exr", ".hdr", ".tif", ".tiff", ".webp", ".bmp")
PICTURES = (*PLAIN, *heif.ENDINGS, *raw.ENDINGS)
NONE = "none"
_MASKS = ("masks", "mask")
_STEREO = "stereo"  # beside the images of COLMAP's image_undistorter
# What folders of masks have in their names.
_TELLING = ("mask", "matte", "matting", "alpha", "foreground", "segment", "silhouette")
# Folders of pictures → of masks.
_INSTEAD = (("images", "masks"), ("image", "mask"), ("rgb", "mask"), ("rgb", "masks"))
# Names of a mask, of a picture's {name} and its {stem}; the second kind also beside the picture.
_SAME = ("{name}{ending}", "{stem}{ending}")
_MARKED = (
    *("{stem}_mask{ending}", "{stem}.mask{ending}", "{stem}-mask{ending}", "mask_{stem}{ending}"),
    *("{name}.mask", "{name}.mask{ending}", "{name}_mask{ending}"),
    *("{stem}.alpha{ending}", "{name}.alpha{ending}"),  # instant-ngp's
    HIDING + "{stem}{ending}",
)


@dataclass
class Sources:
    """What the settings say of where files are: ``images``, ``masks``: folders that stand before
    those of the cameras' file, or None; ``given``: whether masks are looked for in ``masks`` alone,
    which without it are none; ``skip``: whether views whose picture is missing are left out;
    ``turned``: whether pictures without a size in the cameras' file have that after turning;
    ``scale``: how large they are of what the cameras are of; ``without``: names of views that are
    left out, whose files may be missing; ``missing``: names of the pictures that were missing;
    ``elsewhere``: of those that are not in ``images``."""

    images: Path | None = None
    masks: Path | None = None
    given: bool = False
    skip: bool = False
    turned: bool = False
    scale: float = 1.0
    without: Sequence[str] = ()
    missing: list[str] = field(default_factory=list)
    elsewhere: dict[str, None] = field(default_factory=dict)  # in their order


class Missing(InputError):
    """A picture is not there, and may be left out."""


_SOURCES: ContextVar[Sources] = ContextVar("sources")
_AS_IT_IS = Sources()


@contextmanager
def looking(settings: PhotosConfig, root: Path) -> Iterator[Sources]:
    """Within, files are looked for as ``settings`` say. Raises InputError for a folder that is
    none."""
    found = Sources(
        *(_folder(settings, name, root) for name in ("images", "masks")),
        settings.masks is not None,
        settings.missing == "skip",
        settings.orientation == "turned",
        float(settings.scale) if isinstance(settings.scale, (int, float)) else 1.0,
        settings.without,
    )
    before = _SOURCES.set(found)
    try:
        yield found
    finally:
        _SOURCES.reset(before)


def _folder(settings: PhotosConfig, name: str, root: Path) -> Path | None:
    value = getattr(settings, name)
    if value is None or (name == "masks" and value == NONE):
        return None
    for folder in (root / value, Path(value)):
        if folder.is_dir():
            return folder
    none = "; photos.masks=none for no masks at all" if name == "masks" else ""
    raise InputError(f"photos.{name}={value}: no such folder, neither in {root} nor here{none}")


def picture(folder: Path, name: str, where: str, first: bool = False, view: str = "") -> Path:
    """The picture ``name`` below ``folder``, where a known ending may be left out; ``first``: of
    several with it that of the first ending, as loaders of `transforms.json` do; ``view``: that it
    is of, where that is called otherwise. Raises InputError, ``Missing`` where that may be."""
    sources = _SOURCES.get(_AS_IT_IS)
    if sources.images is not None and (found := _below(sources.images, name, first)) is not None:
        return found
    found = _file(folder, name, where, first)
    if found is not None:
        if sources.images is not None:
            sources.elsewhere[called(name)] = None
        return found
    view = view or name
    if sources.skip or _left_out(view):
        sources.missing.append(called(view))
        raise Missing(view)
    raise InputError(
        f"{where}: its picture {folder / name} does not exist: mend the path or remove it; "
        "photos.images=FOLDER says where pictures lie, photos.missing=skip leaves such views out"
    )


def called(path: str) -> str:
    """A view's name of its path, which Windows parts by backslashes."""
    return path.replace("\\", "/").removeprefix("./")


def listing(folders: Iterable[Path], where: str) -> list[Path]:
    """The pictures of the first of ``folders`` that has any, before which stands that of the
    settings, in the order of their names. Raises InputError where none has."""
    given, folders = _SOURCES.get(_AS_IT_IS).images, list(folders)
    for folder in [given] if given is not None else folders:
        if files := inside(folder):
            return files
    looked = given or " nor ".join(str(folder) for folder in folders)
    raise InputError(
        f"{where}: names no pictures, and there are none in {looked}: photos.images=FOLDER says "
        "where they lie"
    )


def inside(folder: Path) -> list[Path]:
    """The pictures of a folder, in the order of their names; none where there is no such."""
    if not folder.is_dir():
        return []
    return [path for path in ordered(folder.iterdir()) if path.suffix.lower() in PICTURES]


def ordered(paths: Iterable[Path]) -> list[Path]:
    """In the order of their names, without hidden ones: beside every file on a disk of another
    system macOS puts a second, ._NAME, which is nothing of its kind."""
    return sorted(path for path in paths if not path.name.startswith("."))


def listed_mask(folder: Path, name: Any, where: str, view: str = "") -> Path | None:
    """The mask that the cameras' file names for a ``view``, or None. Raises InputError, ``Missing``
    where that may be."""
    sources = _SOURCES.get(_AS_IT_IS)
    if not name:
        return None
    if sources.given:
        known = isinstance(name, str) and sources.masks is not None
        return _below(sources.masks, name) if known else None
    found = _file(folder, name, where)
    if found is None and _left_out(view):
        sources.missing.append(called(view))
        raise Missing(view)
    if found is None:
        raise InputError(
            f"{where}: {folder / name} does not exist: mend the path or remove it; "
            "photos.masks=FOLDER says where masks lie, photos.masks=none that there are none"
        )
    return found


def present(make: Callable[..., Any], *arguments: Any) -> Any:
    """What ``make`` makes, or None where a picture is missing that may be."""
    try:
        return make(*arguments)
    except Missing:
        return None


def meant(names: Sequence[str], name: str) -> list[str]:
    """Those of the views ``names`` that a setting means by ``name``: all of theirs, or without
    folder, or without ending as well; or that are known without both."""
    wanted = same_letters(name)
    for part in (str, lambda each: Path(each).name, lambda each: Path(each).stem):
        if found := [each for each in names if same_letters(part(each)) == wanted]:
            return found
    bare = Path(wanted).stem if Path(wanted).suffix.lower() in PICTURES else None
    return [each for each in names if same_letters(each) == bare]


def _left_out(name: str) -> bool:
    """Whether the view of that name may be one that the settings leave out."""
    return any(meant([called(name)], each) for each in _SOURCES.get(_AS_IT_IS).without)


def missed(name: str) -> bool:
    """Whether the view of that name was left out."""
    return name in _SOURCES.get(_AS_IT_IS).missing


def size(image: Path) -> tuple[int, int]:
    """Width and height, pixels, that cameras without a size of their own are of: a picture's, or
    where it was resized what that was before."""
    sources = _SOURCES.get(_AS_IT_IS)
    width, height = images.size(image, sources.turned)
    return round(width / sources.scale), round(height / sources.scale)


def _file(folder: Path, name: Any, where: str, first: bool = True) -> Path | None:
    """``first``: of several whose ending is left out the first one, else they are refused, but for
    what a camera writes beside a picture."""
    if not isinstance(name, str):
        raise InputError(f"{where}: {name!r} is no name of a picture")
    endings = [*PICTURES, *(ending.upper() for ending in PICTURES)]
    for spelt in _spellings(name):
        if os.path.isfile(whole := folder / spelt):  # no to a name that no file can have
            return whole
        found: list[Path] = []
        for path in (Path(f"{whole}{ending}") for ending in endings):
            # One file has both spellings where a disk does not tell them apart.
            if os.path.isfile(path) and not any(path.samefile(other) for other in found):
                found.append(path)
        found = [path for path in found if path.suffix.lower() in PLAIN] or found
        if len(found) > 1 and not first:
            raise InputError(
                f"{where}: {' and '.join(path.name for path in found)} in {whole.parent} are both "
                f"called {whole.name}: move what is not its picture elsewhere, a mask to masks/"
            )
        if found:
            return found[0]
    return None


def _spellings(name: str) -> list[str]:
    """As it stands, as Windows parts folders, and with accents as part of their letters or beside
    them, as macOS has them: a set's file and its disk may differ in that."""
    both = name, name.replace("\\", "/")
    more = (unicodedata.normalize(form, each) for form in ("NFC", "NFD") for each in both)
    return list(dict.fromkeys((*both, *more)))


def same_letters(name: str) -> str:
    """What is the same for all spellings of accents."""
    return unicodedata.normalize("NFC", name)


def existing(folder: Path, name: str) -> Path | None:
    """The picture ``name`` below ``folder``, or None."""
    return _file(folder, name, str(folder))


def below(folders: Iterable[Path], name: str, where: str) -> Path:
    """The picture ``name`` in the first of ``folders`` that has it, as ``picture``. Raises
    InputError, naming the first, where none has."""
    folders = list(folders)
    own = next((folder for folder in folders if existing(folder, name) is not None), folders[0])
    return picture(own, name, where)


def viewed(
    name: str,
    folders: list[Path],
    pose: np.ndarray | Callable[[], np.ndarray],
    inner: dict | Callable[[], dict],
    file: Path | str,
    where: str,
) -> Camera:
    """Of the picture ``below`` folders. ``inner``: its size, focal lengths, principal point and
    lens; ``file``: that says so. What is called is not asked of a missing picture."""
    image = below(folders, name, where)
    pose, inner = (each() if callable(each) else each for each in (pose, inner))
    return Camera(name=name, image=image, to_world=pose, described=str(file), **inner)


def _below(folder: Path, name: str, first: bool = True) -> Path | None:
    """``name`` in a folder that stands for the first of its own ones, or for several of them, also
    with another ending."""
    for spelt in _spellings(name):
        parts = [part for part in Path(spelt).parts if part not in (".", "..", "/")]
        for path in (folder.joinpath(*parts[first:]) for first in range(len(parts))):
            for each in (path, path.with_suffix("")):
                within = str(each.relative_to(folder))
                if (found := _file(folder, within, name, first)) is not None:
                    return found
    return None


def masked(cameras: list[Camera], root: Path, sources: Sources) -> tuple[list[Camera], list[str]]:
    """The cameras with the masks that lie where they usually do, or in the folder given; and what
    should be said of them. Raises InputError where that folder has none that fits."""
    if sources.given and sources.masks is None:
        return [replace(camera, mask=None) for camera in cameras], []
    search = _Search(cameras, root, sources)
    found = [search.mask(camera) for camera in cameras]
    told = []
    times = Counter(found)
    several = sorted(mask for mask, number in times.items() if mask is not None and number > 1)
    listed = {camera.mask for camera in cameras}
    several = [mask for mask in several if mask not in listed]  # as the file says, it may be
    if several:
        told.append(
            f"mask {several[0]} would be that of {times[several[0]]} pictures, so of none: name "
            "masks as their pictures are named, folders too"
        )
        found = [None if mask in several else mask for mask in found]
    without = [camera.name for camera, mask in zip(cameras, found) if mask is None]
    if sources.given and len(without) == len(cameras):
        raise InputError(
            f"photos.masks={sources.masks}: no file there is named as a mask of {without[0]} is, "
            f"such as {Path(without[0]).stem}.png"
        )
    if without and len(without) < len(cameras):
        told.append(
            f"{len(without)} of {len(cameras)} views have no mask, first {without[0]}: all of "
            "their pixels count"
        )
    if without and not sources.given:
        told += search.unused(found)
    return [replace(camera, mask=mask) for camera, mask in zip(cameras, found)], told


class _Search:
    """Folders are listed once."""

    def __init__(self, cameras: list[Camera], root: Path, sources: Sources):
        self._root, self._sources = root, sources
        self._pictures = {camera.image for camera in cameras}
        self._listed: dict[Path, dict[str, Path]] = {}

    def mask(self, camera: Camera) -> Path | None:
        if camera.mask is not None and not self._sources.given:
            return camera.mask
        picture, sources = camera.image, self._sources
        root = self._root_of(picture)
        if sources.given and camera.mask is not None and camera.mask.is_relative_to(sources.masks):
            return camera.mask
        for folder in self._ancestors(picture, root):
            below = picture.relative_to(folder)
            for masks in self._folders(folder, root):
                inside = masks / below.parent
                names = _MARKED if inside == picture.parent else (*_SAME, *_MARKED)
                if (found := self._named(inside, below, names)) is not None:
                    return found
        return None if sources.given else self._named(picture.parent, picture, _MARKED)

    def _root_of(self, picture: Path) -> Path:
        """The set's folder, or in it that of COLMAP's undistorted pictures, which masks of others
        do not fit."""
        above = [each for each in picture.parents if each.is_relative_to(self._root)]
        return next((each for each in above if (each / _STEREO).is_dir()), self._root)

    def _ancestors(self, picture: Path, root: Path) -> list[Path]:
        """Folders around a picture from the set's own to its own."""
        tops = [root, *([self._sources.images] if self._sources.images else [])]
        for top in tops:
            if picture.is_relative_to(top):
                own = [each for each in picture.parents if each.is_relative_to(top)]
                return own[::-1]
        return [picture.parent]

    def _folders(self, pictures: Path, root: Path) -> list[Path]:
        """Where masks may lie of what lies in ``pictures``."""
        if self._sources.given:
            return [self._sources.masks]
        name = pictures.name
        around = [f"{name}_{each}" for each in _MASKS]
        around += [name.replace(a, b) for a, b in _INSTEAD if a in name]
        found = [root / each for each in _MASKS] + [pictures / each for each in _MASKS]
        if pictures != root:
            found += [pictures.parent / each for each in (*_MASKS, *around)]
        return list(dict.fromkeys(found))

    def _named(self, folder: Path, picture: Path, patterns: tuple[str, ...]) -> Path | None:
        here = self._files(folder)
        for pattern in patterns if here else ():
            for ending in PLAIN:
                name = pattern.format(name=picture.name, stem=picture.stem, ending=ending)
                found = here.get(same_letters(name.lower()))
                if found is not None and found not in self._pictures:
                    return found
        return None

    def _files(self, folder: Path) -> dict[str, Path]:
        if folder not in self._listed:
            try:
                files = [file for file in ordered(folder.iterdir()) if file.is_file()]
            except OSError:
                files = []
            self._listed[folder] = {same_letters(file.name.lower()): file for file in files}
        return self._listed[folder]

    def unused(self, masks: list[Path | None]) -> list[str]:
        """Of folders that look like masks, none of which is one."""
        used = {mask.parent for mask in masks if mask is not None}
        first = min(self._pictures)
        root, told = self._root_of(first), []
        for depth in ("*", "*/*"):
            for folder in sorted(self._root.glob(depth)):
                below = str(folder.relative_to(self._root)).lower()
                if not any(word in below for word in _TELLING):
                    continue
                if any(each == folder or each.is_relative_to(folder) for each in used):
                    continue
                files = self._files(folder) if folder.is_dir() else {}
                files = [p for p in files.values() if p.suffix.lower() in PLAIN]
                if files and not folder.is_relative_to(root):
                    told.append(
                        f"{folder} looks like masks of pictures before they were undistorted to "
                        f"{root}, so of none that is read: masks of these belong in {root}/masks"
                    )
                elif files and not self._pictures & set(files):
                    told.append(
                        f"{folder} looks like masks, but {files[0].name} there is the mask of no "
                        f"picture, and none is masked by it: call that of {first.name} "
                        f"{first.stem}.png or {first.name}.png, or say photos.masks=none"
                    )
        return told
