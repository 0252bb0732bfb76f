"""What `isas photos` prints of pictures: those that are alike in one row."""

from __future__ import annotations

from collections.abc import Iterable

from rich.table import Table
from rich.text import Text

from ..runtime import images
from ..scene.photos import checks, exif
from ..scene.photos.photographs import Photographs

# More views than that are told by their ranges, but for those that stand out.
_MOST = 40
_OF_PICTURES = "view", "pixels", "focal length", "count", "lost"
_OF_OBJECT = "distance", "object seen", "spans"
_OF_POINTS = "points", "off by"
# Columns of words, and to how many letters these may be folded.
_FOLDABLE, _FOLDED = ("view", "lost"), 16


def cameras(checked: list[checks.View], taken: Photographs) -> Table:
    """What files say of the pictures: those alike in kind in one row, with the ranges of their
    numbers."""
    described = {camera.name: camera for camera in taken.capture.cameras}
    groups: dict[tuple, list] = {}
    for view in checked:
        camera = described[view.photograph.camera.name]
        said = exif.read(camera.image)
        alpha = "alpha" if images.has_alpha(camera.image) else "none"
        mask = alpha if camera.mask is None else "file"
        size = f"{camera.width}×{camera.height}"
        key = (size, camera.lens.kind, *camera.lens.terms, mask, said is None)
        groups.setdefault(key, []).append((camera, mask, said))
    table = Table(title="as their files have them")
    table.add_column("views", overflow="fold")
    for name in ("pixels", "focal length", "lens", "mask", "EXIF exposure"):
        table.add_column(name, overflow="fold")
    for group in groups.values():
        each, masks, said = zip(*group)
        names = [camera.name for camera in each]
        several = f"{len(names)}: {names[0]} … {names[-1]}"
        table.add_row(
            Text(several if len(names) > 1 else names[0]),
            f"{each[0].width}×{each[0].height}",
            _range([camera.fx for camera in each], ".1f"),
            _lens(each),
            masks[0],
            _exposure(said),
        )
    return table


def exposures(taken: Photographs) -> float:
    """How many times as long as the darkest picture the brightest was exposed, by what the
    pictures say beyond what the cameras' file does; 1 where that is not known of all."""
    found = []
    for camera in taken.capture.cameras:
        said = exif.read(camera.image)
        if said is None:
            return 1.0
        found.append(said.exposure / camera.exposure[1])
    return max(found) / min(found)


def views(checked: list[checks.View], taken: Photographs, width: int) -> list[Table]:
    """What was seen of each; of many, those that stand out and the ranges of the others. In two
    tables, the second of the object, where one is wider than ``width`` columns of text."""
    held = f"{len(taken.held)} held out: {taken.capture.kind}"
    title = f"{len(taken.shown)} views to learn from, {held}"
    own = taken.surface is not None
    known = any(view.apart is not None for view in checked)
    bright = any(view.photograph.camera.exposure != (1, 1, 1) for view in checked)
    heads = [*_OF_PICTURES, *(["exposure"] if bright else [])]
    pictured = len(heads)
    heads += [*(_OF_OBJECT if own else ()), *(_OF_POINTS if known else ())]
    few = len(checked) <= _MOST
    single = checked if few else [view for view in checked if _stands_out(view)][:_MOST]
    told = set(map(id, single))
    rest = [view for view in checked if id(view) not in told]
    groups = [[view] for view in single] + ([rest] if rest else [])
    cells = [heads, *(_row(group, own, known, bright) for group in groups)]
    if _wide(cells) <= width or pictured == len(heads):
        return [_table(title, cells)]
    seen = [[row[0], *row[pictured:]] for row in cells]
    return [_table(title, [row[:pictured] for row in cells]), _table("what they see", seen)]


def _wide(cells: list[list[str]]) -> int:
    """Columns of text that a table takes at least whose first row are its heads: names, and why
    pixels are lost, may be folded, numbers not."""
    found = 1
    for head, *column in zip(*cells):
        most = max(map(len, column), default=0)
        found += 3 + max(min(most, _FOLDED) if head in _FOLDABLE else most, *map(len, head.split()))
    return found


def _table(title: str, cells: list[list[str]]) -> Table:
    table = Table(title=title)
    for name in cells[0]:
        # Of heads of two words each may have a line; a number keeps to one.
        whole = name not in _FOLDABLE and " " not in name
        just = "left" if name == "view" else "right"
        table.add_column(name, justify=just, overflow="fold", no_wrap=whole)
    for row in cells[1:]:
        table.add_row(*map(Text, row))  # as pictures are called
    return table


def _stands_out(view: checks.View) -> bool:
    return (
        (view.photograph.mask > 0).mean() < checks.SEEN
        or (view.inside is not None and view.inside < checks.SEEN)
        or (view.spanned is not None and view.spanned < checks.SPANNED)
        or (view.apart is not None and view.apart > checks.OFF)
    )


def _row(group: list[checks.View], own: bool, known: bool, bright: bool) -> list[str]:
    """Of views, the ranges of their numbers."""
    seen = [view.photograph for view in group]
    cameras = [each.camera for each in seen]
    name = cameras[0].name + (" (held out)" if group[0].held else "")
    if len(group) > 1:
        name = f"{len(group)} views: {cameras[0].name} … {cameras[-1].name}"
    lost: dict[str, list[int]] = {}
    for each in seen:
        for why, count in each.lost.items():
            if count:
                lost.setdefault(why, []).append(count)
    row = [
        name,
        ", ".join(dict.fromkeys(f"{camera.width}×{camera.height}" for camera in cameras)),
        _range([camera.fx for camera in cameras], ".1f"),
        _range([(each.mask > 0).mean() for each in seen], ".0%"),
        ", ".join(f"{_range(counts, 'd')} {why}" for why, counts in lost.items()) or "–",
    ]
    if bright:
        told = [e for camera in cameras for e in dict.fromkeys(camera.exposure)]
        single = "/".join(f"{e:.4g}" for e in told)
        row.append(single if len(group) == 1 else _range(told, ".4g"))
    if own:
        row.append(_range([view.distance for view in group], ".4g"))
        row += [_range([getattr(view, n) for view in group], ".0%") for n in ("inside", "spanned")]
    if known:
        found = [view for view in group if view.apart is not None]
        row.append(_range([len(view.points[0]) for view in found], "d"))
        row.append(f"{_range([view.apart for view in found], '.2f')} px" if found else "")
    return row


def _range(values: Iterable, spelt: str) -> str:
    """Of numbers, the least and the greatest, as far as these are spelt unlike."""
    values = list(values)
    if not values:
        return ""
    ends = dict.fromkeys(format(end, spelt) for end in (min(values), max(values)))
    return " to ".join(ends)


def _lens(cameras) -> str:
    lenses = [camera.lens for camera in cameras]
    if len(set(map(str, lenses))) == 1:
        return str(lenses[0])
    kind = [] if lenses[0].kind == "flat" else [lenses[0].kind]
    terms = [f"{n} {_range([x.terms[n] for x in lenses], '.3g')}" for n in lenses[0].terms]
    return ", ".join(kind + terms)


def _exposure(said: tuple) -> str:
    if said[0] is None:
        return "none"
    told = list(dict.fromkeys(map(str, said)))
    if len(told) == 1:
        return told[0]
    ratio = max(each.exposure for each in said) / min(each.exposure for each in said)
    return f"{told[0]} and {len(told) - 1} others, up to {ratio:.3g} times as bright"
