"""`isas relight`: a run's result against pictures of other places and lights."""

from __future__ import annotations

import math
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ..config.photographs import CAMERA, UPS, PhotosConfig
from ..engine import resumption
from ..records.files import write_json
from ..runtime import backend, interrupt
from ..runtime.errors import InputError

SCORES = "scores.json"
_HEADS = {"psnr_h": "PSNR-H", "psnr_l": "PSNR-L", "ssim": "SSIM"}


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
    typed, arrays = resumption.result(folder)
    with interrupt.prompt():
        backend.start(typed.variant, typed.threads)
        from ..measure import relighting
        from ..scene import export, relit

        if told := resumption.changed_since(folder, typed):
            print(told, file=sys.stderr)
        cameras, over = _cameras(pictures, typed.scene.photos)
        rendering = [relit.cut(camera, width) for camera in cameras]
        lights = _lights(light, [camera.name for camera in cameras])
        own = typed.scene.photos
        how = own.up if up is None else up, own.turn if turn is None else turn
        scene = export.result(typed.scene, arrays)
        output = output or folder / "relit"
        found, console = {}, Console()
        for camera, image in zip(cameras, relit.views(scene, rendering, lights, *how, spp)):
            where = f"{pictures}: {camera.name}"
            mask = None if camera.hides else camera.mask  # which is to say where the object is
            turned = camera.name in over
            how_lit = turned, light is not None
            found[camera.name] = relighting.of_picture(image, camera, mask, where, *how_lit)
            relit.write(output, camera.name, image)
    mean = relighting.mean(found)
    write_json(output / SCORES, {"views": found, "mean": mean, "light": light and str(light)})
    table = Table("view", *_HEADS.values())
    for name, scores in [*found.items(), ("mean", mean)]:
        table.add_row(name, *(f"{scores[key]:.4g}" for key in _HEADS))
    console.print(table)
    print(f"renderings and {SCORES}: {output}")
    return 0


def _cameras(pictures: Path, own: PhotosConfig) -> tuple[list, set[str]]:
    """Of a folder of photographs, or of a file in one, in the world and with the orientation that
    the run's ``own`` have; and the names of those whose pictures are turned. Raises InputError."""
    from ..scene.photos import finding, reading, turns

    if not pictures.exists() and str(pictures) not in reading.OWN:
        raise InputError(f"{pictures}: no such folder of photographs, nor file of cameras")
    file = pictures.name if pictures.is_file() else None
    settings = PhotosConfig(str(pictures if file is None else pictures.parent), cameras=file)
    root = reading.folder_of(settings.path)
    with finding.looking(settings, root) as sources:
        found = reading.read(settings.path, None, settings.cameras)
        if found.worlds and own.world != "mesh":
            found = reading.read(settings.path, None, settings.cameras, own.world)
    cameras, told = finding.masked(found.cameras, root, sources)
    over, more = turns.turned(cameras, found, own.orientation)
    for line in (*found.notes, *told, *more):
        print(line, file=sys.stderr)
    return cameras, over


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
