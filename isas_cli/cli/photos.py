"""`isas photos`: photographs, their cameras and the object, looked at before anything is spent."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from ..config import schema
from ..config.compose import compose, translate
from ..runtime.errors import InputError
from ..scene.photos import checks, photographs, sheet

_OUTPUT = "output="


def main(arguments: list[str]) -> int:
    """Print the table of views and warnings, write the sheet. Raises IsasError; returns 0."""
    settings, folders, output = [], [], None
    for argument in arguments:
        if argument.startswith("-"):
            raise InputError(f"{argument}: no such flag; see isas photos --help")
        if argument.startswith(_OUTPUT):
            output = Path(argument.removeprefix(_OUTPUT))
        else:
            (settings if "=" in argument else folders).append(argument)
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
    console.print(_table(checked, taken))
    for warning in checks.warnings(checked, taken):
        console.print(f"warning: {warning}", highlight=False, markup=False)
    output = output or Path(f"photos-{Path(folders[0]).resolve().name}.png")
    shown = sheet.write(checked, taken, output)
    told = "" if shown == len(checked) else f" ({shown} of {len(checked)} views)"
    print(f"sheet: {output}{told}")
    return 0


def _table(checked: list[checks.View], taken: photographs.Photographs) -> Table:
    held = f"{len(taken.held)} held out: {taken.capture.kind}"
    table = Table(title=f"{len(taken.shown)} views to learn from, {held}")
    table.add_column("view", no_wrap=True)
    for name in ("pixels", "focal length", "count", "lost"):
        table.add_column(name, justify="right")
    own = taken.surface is not None
    for name in ("distance", "object seen", "spans") if own else ():
        table.add_column(name, justify="right")
    known = any(view.apart is not None for view in checked)
    for name in ("points", "off by") if known else ():
        table.add_column(name, justify="right")
    bright = any(view.photograph.camera.exposure != (1, 1, 1) for view in checked)
    if bright:
        table.add_column("exposure", justify="right")
    for view in checked:
        shown, camera = view.photograph, view.photograph.camera
        lost = ", ".join(f"{n} {why}" for why, n in shown.lost.items() if n)
        row = [
            camera.name + (" (held out)" if view.held else ""),
            f"{camera.width}×{camera.height}",
            f"{camera.fx:.1f}",
            f"{(shown.mask > 0).mean():.0%}",
            lost or "–",
        ]
        if own:
            row += [f"{view.distance:.4g}", f"{view.inside:.0%}", f"{view.spanned:.0%}"]
        if known:
            apart = view.apart is not None
            row += [str(len(view.points[0])), f"{view.apart:.2f} px"] if apart else ["", ""]
        if bright:
            row.append("/".join(f"{e:.4g}" for e in dict.fromkeys(camera.exposure)))
        table.add_row(*row)
    return table
