"""`isas relight`: a run's result against pictures of other places and lights."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..config import paths
from ..config.photographs import CAMERA, UPS, PhotosConfig
from ..engine import resumption
from ..engine.display import number, say
from ..records.files import write_json
from ..runtime import backend, images, interrupt
from ..runtime.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from ..scene.photos.camera import Camera

SCORES = "scores.json"
_HEADS = {"psnr_h": "PSNR-H", "psnr_l": "PSNR-L", "ssim": "SSIM", "flip": "FLIP"}


def main(
    folder: Path,
    pictures: Path,
    light: Path | None = None,
    up: str | None = None,
    turn: float | None = None,
    width: int | None = None,
    spp: int = 256,
    output: Path | None = None,
) -> int:
    """Render the result of the run in ``folder`` as the cameras of ``pictures`` see it, a folder of
    photographs or a file of cameras in one, and score it as Stanford-ORB does
    (``measure.relighting``). ``light``: an environment in place of the scene's lights, or a folder
    with one for each view; ``up``, ``turn``: as ``photos.up`` and ``photos.turn`` (None: those of
    the run), or ``camera``, see ``relit.views``; ``width``: pixels of the renderings. Renderings
    and scores.json go into ``output`` (None: ``folder/relit``). Raises InputError; returns 0."""
    _check(light, up, turn, width, spp)
    typed, arrays = resumption.result(folder)
    with interrupt.prompt():
        backend.start(typed.variant, typed.threads)
        from ..measure import relighting
        from ..scene import export, relit
        from ..scene.photos import surroundings, turns

        if told := resumption.changed_since(folder, typed):
            say(told)
        own = typed.scene.photos
        cameras, over = _cameras(pictures, own)
        if not any(relighting.masked(camera.image, _mask(camera)) for camera in cameras):
            raise InputError(
                f"{pictures}: no view has a mask or alpha, which say what is scored: put masks "
                "into its folder masks, called as the pictures are"
            )
        across, doubts = turns.across(cameras, over)
        files = [camera.image for camera in cameras]
        doubts += images.unheeded(files, [images.doubted(f, _linear(f, own)) for f in files])
        rendering = [relit.cut(camera, width) for camera in cameras]
        lights = _lights(light, [camera.name for camera in cameras])
        how = own.up if up is None else up, own.turn if turn is None else turn
        upwards = None if how[0] == CAMERA else how[0]
        for file in dict.fromkeys(each for each in lights if each is not None):
            doubts += surroundings.doubts(file, upwards, cameras, ("--light ", "--up="))
            upwards = None  # said once for all
        for line in doubts:
            say(line)
        # What the run found of views is of its own: their exposures are fitted anew.
        fitted = light is not None or own.exposure != "fixed"
        for name in ("refine", "lens"):
            if getattr(own, name):
                told = (
                    f"photos.{name}: cameras are as their file has them, not as the run found them"
                )
                say(told)
        scene = export.result(typed.scene, arrays)
        output = output or folder / "relit"
        made = zip(cameras, rendering, relit.views(scene, rendering, lights, *how, spp))
        found, left = {}, []
        for camera, seen, (image, lost) in made:
            relit.write(output, camera.name, image)
            where = f"{pictures}: {camera.name}"
            if lost:
                say(f"{where}: of {lost} pixels paths that are no numbers are left out")
            try:
                ways = camera.name in over, camera.name in across
                found[camera.name] = _score(image, seen, camera, own, where, ways, fitted)
            except relighting.Nothing as error:
                left.append(camera.name)
                say(f"{where}: left out: {str(error).removeprefix(f'{where}: ')}")
            if found:
                told = {"views": found, "mean": relighting.mean(found), "left_out": left}
                write_json(output / SCORES, told | {"light": light and str(light)})
        if not found:
            raise InputError(f"{pictures}: no view can be scored, for what is said above")
        if relighting.mean(found)["in_range"] < 0.5:
            say(
                f"{pictures}: what counts is often brighter than 1 or all below 0.05, and scores "
                "are of 0 to 1, as a screen shows it: they tell little; scale the pictures"
            )
    table = Table("view", *_HEADS.values())
    for name, scores in [*found.items(), ("mean", relighting.mean(found))]:
        known = (scores[key] for key in _HEADS)
        table.add_row(escape(name), *(number(each, ".4g") for each in known))
    Console().print(table)
    print(f"renderings and {SCORES}: {output}")
    return 0


def _check(
    light: Path | None, up: str | None, turn: float | None, width: int | None, spp: int
) -> None:
    """Raises InputError for settings that cannot be."""
    if spp < 1:
        raise InputError(f"--spp {spp}: at least 1")
    if up not in (None, *UPS, CAMERA):
        raise InputError(f"--up {up}: valid: {', '.join(UPS)}, {CAMERA}")
    if turn is not None and not math.isfinite(turn):
        raise InputError(f"--turn {turn}: degrees")
    if light is None and (up, turn) != (None, None):
        raise InputError("--up and --turn say how the environment of --light stands: give --light")
    if up == CAMERA and turn is not None:
        raise InputError(f"--turn {turn:g}: with --up {CAMERA} a light stands to the camera")
    if width is not None and width < 1:
        raise InputError(f"--width {width}: at least 1")


def _score(
    image: np.ndarray,
    seen: Camera,
    camera: Camera,
    own: PhotosConfig,
    where: str,
    ways: tuple[bool, bool],
    fitted: bool,
) -> dict:
    """Of what a ``seen`` camera renders, beside the picture of the ``camera`` that it stands for;
    ``ways``: whether that is turned, and whether its mask lies otherwise. Raises InputError."""
    from ..measure import relighting

    mask = _mask(camera)
    turned, across = ways[0], None if mask is None else ways[1]
    linear = _linear(camera.image, own)
    how = turned, fitted, linear, across, own.saturated
    return relighting.of_picture(image, seen, camera, mask, where, *how)


def _mask(camera: Camera) -> Path | None:
    """The file that says where the object is, which a mask of what moves does not."""
    return None if camera.hides else camera.mask


def _linear(file: Path, own: PhotosConfig) -> bool | None:
    """As ``images.load`` has it: of files of light the encoding of the run's ``own`` says
    nothing."""
    from ..scene.photos import importing

    return None if importing.of_light(file) else importing.linear(file, own.encoding)


def _cameras(pictures: Path, own: PhotosConfig) -> tuple[list, set[str]]:
    """Of a folder of photographs, or of a file in one, as large as their pictures are, in the world
    and with the orientation that the run's ``own`` have; where it is the run's own set, with all
    that the run says of where files are. And the names of those whose pictures are turned. Raises
    InputError."""
    from ..scene.photos import finding, layouts, photographs, reading, turns

    if not pictures.exists() and str(pictures) not in reading.OWN:
        raise InputError(f"{pictures}: no such folder of photographs, nor file of cameras")
    place = pictures if pictures.is_file() else reading.folder_of(str(pictures))
    kept = {name: getattr(own, name) for name in ("encoding", "orientation")}
    whole = place.absolute()
    tries = [(root, str(whole.relative_to(root))) for root in layouts.around(whole)]
    if _is_of(place, own):
        kept |= {n: getattr(own, n) for n in ("images", "masks", "scale", "missing", "without")}
        tries = [(paths.of_set(own.path), own.cameras)]
    for root, file in tries:
        file = None if file == "." else file
        settings = PhotosConfig(str(root), file, **kept)
        try:
            with finding.looking(settings, root) as sources:
                found = reading.read(settings.path, None, file)
                if found.worlds and own.world != "mesh":
                    sources.missing.clear()
                    found = reading.read(settings.path, None, file, own.world)
            break
        except InputError as error:
            if root == tries[-1][0]:
                hint = "; photos.… are the run's, where SET is its photos.path"
                raise InputError(f"{error}{hint if 'photos.' in str(error) else ''}") from None
    found.cameras = reading.without(found.cameras, settings.without, sources.missing)
    photographs.check(found, sources)
    found.notes += photographs.elsewhere(found, sources)
    cameras, told = finding.masked(found.cameras, root, sources)
    over, more = turns.turned(cameras, found, settings.orientation)
    for line in (*found.notes, *photographs.left_out(sources), *told, *more):
        say(line)
    settings = replace(settings, scale=settings.scale or "auto")
    sizes = [images.size(camera.image, camera.name in over) for camera in cameras]
    return [turns.resized(c, size, settings) for c, size in zip(cameras, sizes)], over


def _is_of(place: Path, own: PhotosConfig) -> bool:
    """Whether a folder, or a file of cameras, is the one that a run's photographs are of."""
    from ..scene.photos import layouts, reading

    if own.path is None:
        return False
    root = paths.of_set(own.path)
    mine = {root, root / (own.cameras or "")}
    with contextlib.suppress(InputError):  # of a set that is gone
        _, file = reading.source(own.path, own.cameras)
        mine |= {file, *(each for each in layouts.around(file) if each.is_relative_to(root))}
    return any(each.exists() and each.samefile(place) for each in mine)


def _lights(light: Path | None, names: list[str]) -> list[Path | None]:
    """The environments of views. Raises InputError."""
    from ..measure import relighting

    if light is None or light.is_file():
        return [light] * len(names)
    if not light.is_dir():
        raise InputError(f"--light {light}: no such file or folder")
    found: dict[Path, str] = {}
    for name in names:
        # As Stanford-ORB has them, of a scene's name and a picture's number.
        own = light / Path(name).parts[0] / "env_map"
        one = relighting.of_name(own, Path(name).name) or relighting.of_name(light, name)
        if one is None:
            raise InputError(
                f"--light {light}: no environment for {name}, such as {Path(name).stem}.exr"
            )
        if found.setdefault(one, name) != name:
            raise InputError(
                f"--light {light}: {one} would be that of {found[one]} and of {name}: put one for "
                "each below folders that are called as the views' are"
            )
    return list(found)
