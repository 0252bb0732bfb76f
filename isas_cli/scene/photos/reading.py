"""Which format a folder of photographs has, and what it holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ...runtime import guests
from ...runtime.errors import InputError, nearest
from ...scenes.library import ASSETS
from . import (
    colmap,
    meshroom,
    metashape,
    neus_llff,
    opencv,
    openmvg,
    ours,
    polycam,
    realitycapture,
    transforms,
)
from .base import Asked, Capture
from .camera import Camera
from .finding import meant

# Sets that come with isas, by name.
OWN = ("chessboard", "head")
# Of Meshroom and OpenMVG.
_BINARY = {".abc", "sfm_data.bin"}
# In place of names, the views that the files hold out.
GIVEN = "given"
# In the order in which a folder is asked: what people write themselves first.
_OURS = (ours, transforms, colmap, opencv, metashape, polycam, realitycapture, neus_llff)
_FORMATS = (*_OURS, meshroom, openmvg, *guests.loaded(guests.CAMERAS))


def folder_of(path: str) -> Path:
    """The folder that ``photos.path`` names: one's own, or a set that comes with isas."""
    folder = Path(path)
    if folder.is_dir():
        return folder
    if path in OWN:
        return ASSETS / path
    if folder.is_file():
        raise InputError(
            f"photos.path={path}: is a file: give the folder that it lies in, and "
            f"photos.cameras={folder.name}"
        )
    raise InputError(
        f"photos.path={path}: no such folder; sets that come with isas: {', '.join(OWN)}"
    )


def read(path: str, test=None, cameras: str | None = None, world: str = "mesh") -> Capture:
    """The cameras in the folder ``path``, or of its file or folder ``cameras``, with those held out
    where ``test`` is ``given``; ``world``: as ``photos.world``. Raises InputError where there are
    none that can be read, for a camera that is none, and for two of one picture."""
    folder, (module, file) = folder_of(path), source(path, cameras)
    capture = module.read(file, Asked(folder, test == GIVEN, world, cameras is not None))
    if world != "mesh" and not capture.worlds:
        raise InputError(
            f"photos.world={world}: {file} tells of no other world: leave photos.world out"
        )
    if test == GIVEN and not capture.held:
        one, train = transforms.NAMES
        raise InputError(
            f"photos.test={test}: {file} gives no views to hold out: looked for test_filenames in "
            f"{one}, and for {transforms.TEST} beside {train}"
        )
    for name, times in Counter(camera.name for camera in capture.cameras).most_common(1):
        if times > 1:
            raise InputError(f"{file}: {name} is listed {times} times: once a picture")
    return capture


def source(path: str, cameras: str | None = None):
    """The format of the folder ``path``, or of its file or folder ``cameras``, and the file that
    says so. Raises InputError."""
    folder = folder_of(path)
    if cameras is None:
        return _found(folder, f"photos.path={path}")
    return _named_file(folder, cameras)


def _found(folder: Path, where: str):
    """The format of a folder, and the file that says so. ``where``: for messages."""
    # The first alone: others may ask which of their files is meant.
    every = ((module, file) for module in _FORMATS if (file := module.find(folder)) is not None)
    first = found = next(every, None)
    while found is not None and _foreign(*found):
        found = next(every, None)
    if found is None and first is not None and first[0] is ours:
        raise InputError(
            f"{where}: {first[1]} is another program's of that name, as Gaussian splatting's and "
            "OpenDroneMap's, which are not read, and there are no other cameras: give the folder "
            "that it was made from"
        )
    found = found or first
    if found is None:
        raise InputError(
            f"{where}: no cameras there: looked for {ours.NAME}, "
            f"{', '.join(transforms.NAMES)}, COLMAP's cameras.txt and cameras.bin (also below "
            "sparse and dense), OpenCV's YAML or XML, Metashape's XML, Polycam's keyframes, "
            "RealityCapture's XMP, NeuS' cameras_sphere.npz, LLFF's poses_bounds.npy, Meshroom's "
            "cameras.sfm and OpenMVG's sfm_data.json"
        )
    return found


def _foreign(module, file: Path) -> bool:
    """Whether a file is probably another program's of that name: others are asked before."""
    asked = getattr(module, "foreign", None)
    return asked is not None and asked(file)


def _named_file(folder: Path, cameras: str):
    """As ``_found``, of ``photos.cameras``: a file, or a folder that is asked as any other."""
    place = folder / cameras
    if place.is_dir():
        try:
            return _found(place, f"photos.cameras={cameras}")
        except InputError as error:
            # A file that is advised is named in that folder.
            told = str(error).replace(": photos.cameras=", f": photos.cameras={cameras}/")
            raise InputError(told) from None
    if not place.is_file():
        raise InputError(f"photos.cameras={cameras}: no such file or folder in {folder}")
    # Any other JSON may be of nerfstudio's form.
    asked = sorted(_FORMATS, key=lambda module: module is transforms)
    module = next((module for module in asked if module.claims(place)), None)
    if module is None and {place.suffix, place.name} & _BINARY:
        raise InputError(
            f"photos.cameras={cameras}: of Meshroom and OpenMVG JSON alone is read: convert it "
            "(aliceVision_convertSfMFormat to cameras.sfm, openMVG_main_ConvertSfM_DataFormat to "
            "sfm_data.json), or export it to COLMAP (aliceVision_exportColmap, "
            "openMVG_main_openMVG2Colmap)"
        )
    if module is None:
        raise InputError(f"photos.cameras={cameras}: is of no format of cameras that isas reads")
    return module, place


def split(capture: Capture, test) -> tuple[list[Camera], list[Camera]]:
    """Views to learn from, and views held out. ``test``: None, n for every n-th (the n-th the
    first), ``given``, or names of pictures, with or without folder and ending. Raises
    InputError."""
    cameras = capture.cameras
    if test is None:
        return cameras, []
    if isinstance(test, int) and not isinstance(test, bool):
        if test < 2:
            raise InputError(f"photos.test={test}: every n-th view is held out, n at least 2")
        held = cameras[test - 1 :: test]
    elif test == GIVEN:
        held = [camera for camera in cameras if camera.name in capture.held]
    elif isinstance(test, Sequence):
        names = [test] if isinstance(test, str) else test
        known = [camera.name for camera in cameras]
        wanted = [_named(known, str(name), "test") for name in names]
        held = [camera for camera in cameras if camera.name in wanted]
    else:
        raise InputError(f"photos.test={test}: give a list of pictures [a.png,b.png], n, or given")
    names = {camera.name for camera in held}
    kept = [camera for camera in cameras if camera.name not in names]
    if not kept:
        raise InputError("photos.test holds every view out: leave one to learn from")
    if not names:
        raise InputError(f"photos.test={test}: of {len(cameras)} views that holds none out")
    return kept, [camera for camera in cameras if camera.name in names]


def without(cameras: list[Camera], names: Sequence[str], missing: list[str]) -> list[Camera]:
    """The views but those, which are named as in ``split``. ``missing``: names of others, whose
    files are missing, which lose those as well. Raises InputError."""
    there = [camera.name for camera in cameras]
    every = [*there, *missing]
    out = [_named(there if meant(there, name) else every, name, "without") for name in names]
    missing[:] = [name for name in missing if name not in out]
    left = [camera for camera in cameras if camera.name not in out]
    if not left and not missing:
        raise InputError("photos.without leaves every view out: leave one to learn from")
    return left


def _named(known: list[str], name: str, setting: str) -> str:
    found = meant(known, name)
    if len(found) > 1:
        raise InputError(
            f"photos.{setting}: {name} is the name of {len(found)} views, "
            f"{' and '.join(found[:2])}: give it with its folder"
        )
    if not found:
        raise InputError(f"photos.{setting}: no view {name}; {nearest(name, known[:40])}")
    return found[0]
