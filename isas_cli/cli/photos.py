"""`isas photos`: photographs, their cameras and the object, looked at before anything is spent."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

from rich.console import Console

from ..config import schema
from ..config.compose import compose, translate
from ..runtime.errors import InputError
from ..scene.photos import brightness, checks, photographs, reading, sheet
from . import one, photo_tables

_OUTPUT = "output="
_OF_HULLS = ("photos.start=", "photos.voxels=")
# Exposures that differ by less than a sixth of a stop are alike.
_ALIKE = 2 ** (1 / 6)


def main(arguments: list[str]) -> int:
    """Print the tables of cameras and views, notes and warnings, write the sheet, and say what to
    run. Raises IsasError; returns 0."""
    settings, folders, output = [], [], None
    one.no_flags("photos", arguments)
    for argument in arguments:
        if argument.startswith(_OUTPUT):
            output = Path(os.path.expanduser(argument.removeprefix(_OUTPUT)))
        else:
            folder = "=" not in argument or os.path.isdir(os.path.expanduser(argument))
            (folders if folder else settings).append(argument)
    folders += [each.partition("=")[2] for each in settings if each.startswith("photos.path=")]
    settings = [each for each in settings if not each.startswith("photos.path=")]
    if len(folders) != 1:
        raise InputError("give one folder of photographs: isas photos DIR [photos.mesh=FILE]")
    for setting in settings:
        if not setting.lstrip("+").startswith("photos."):
            raise InputError(f"{setting}: isas photos takes settings of photographs, photos.…")
    composed = compose(translate(["scene=photos", f"photos.path={folders[0]}", *settings]))
    taken = photographs.load(schema.typed(composed).scene.photos, shapeless=True)
    checked = checks.views(taken)
    console = Console()
    console.print(photo_tables.cameras(checked, taken))
    for table in photo_tables.views(checked, taken, console.width):
        console.print(table)
    for note in taken.capture.notes:
        console.print(f"note: {note}", highlight=False, markup=False)
    for warning in [
        *checks.warnings(checked, taken),
        *_unlike(taken),
        *_lit(taken),
    ]:
        console.print(f"warning: {warning}", highlight=False, markup=False)
    folder = reading.folder_of(taken.settings.path)
    output = output or _place(folder)
    shown = sheet.write(checked, taken, output, folder)
    told = "" if shown == len(checked) else f" ({shown} of {len(checked)} views)"
    print(f"sheet: {output}{told}")
    print(_command(folders[0], settings, taken.surface is not None))
    return 0


def _unlike(taken: photographs.Photographs) -> list[str]:
    """Whether pictures were exposed unlike, which nothing accounts for."""
    if taken.settings.exposure == "channels":
        return []
    cast = None if taken.surface is None else brightness.tinted(taken.all, taken.surface)
    tints = []
    if cast is not None:
        factor, more, less = cast
        tints = [
            f"the same places of the object have another tint, up to {factor:.3g} times in {more} "
            f"what it is in {less}: another white balance (photos.exposure=channels finds a factor "
            "a channel each), or the light moved"
        ]
    if taken.settings.exposure != "fixed":
        return tints
    ratio = photo_tables.exposures(taken)
    if ratio >= _ALIKE:
        return tints + [
            f"by their EXIF, pictures were exposed unlike, up to {ratio:.3g} times: "
            "photos.exposure=scale finds a factor each"
        ]
    seen = None if taken.surface is None else brightness.unlike(taken.all, taken.surface)
    if seen is None:
        return tints
    factor, bright, dark = seen
    return tints + [
        f"the same places of the object are up to {factor:.3g} times as bright in {bright} as in "
        f"{dark}: exposed unlike (photos.exposure=scale finds a factor each), or the light moved, "
        "or the surface is glossy"
    ]


def _lit(taken: photographs.Photographs) -> list[str]:
    """Whether the light goes with the camera, where no environment can, and whether pictures are
    darker towards their corners."""
    if taken.surface is None:
        return []
    seen = taken.all, taken.surface
    found = []
    if (factor := brightness.moved(*seen)) is not None:
        found.append(
            f"the same places of the object are about {factor:.2g} times as bright or dark by how "
            "they are turned to the camera: the light moved with it, as of a turntable or a flash; "
            "isas has one light for all views, and shadows and highlights go into the texture"
        )
    if (factor := brightness.fallen(*seen)) is not None:
        found.append(
            f"the same places of the object are {1 - factor:.0%} darker where the margins of "
            "pictures show them: the lens darkens their corners (vignetting), for which isas has "
            "no unknown: develop them with the lens's profile"
        )
    return found


def _place(folder: Path) -> Path:
    """Where the sheet goes, where nothing else is said: called as the folder is, with a number
    where another set's sheet, or any other file, has that name."""
    number = 1
    while True:
        more = "" if number == 1 else f"-{number}"
        path = Path(f"photos-{folder.resolve().name}{more}.png")
        if not path.exists() or sheet.shows(path, folder):
            return path
        number += 1


def _command(folder: str, settings: list[str], described: bool) -> str:
    """What runs with the same settings, as a shell takes it."""
    # Without an object there is nothing to run: what is missing stands where it goes, and what is
    # of a hull does not.
    kept = [each for each in settings if described or not each.startswith(_OF_HULLS)]
    words = ["isas", "run", "scene=photos", f"photos.path={folder}", *kept]
    return shlex.join(words) + ("" if described else " photos.mesh=FILE")
