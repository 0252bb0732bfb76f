"""`isas scenes`: what there is to choose from."""

from __future__ import annotations

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from ..config import method, searchpath

_WIDE = 1000  # columns, of which a table takes what it needs


def _comment(text: str) -> str:
    first = text.splitlines()[0] if text else ""
    return first.lstrip("# ").strip() if first.startswith("#") else ""


def main() -> int:
    """Print scenes with their unknowns and sizes, then samplers and losses."""
    console = Console()
    if not console.is_terminal:  # for files and other programs a line a row
        console.width = _WIDE
    # For copying: never cut.
    names, keys = Column("scene", no_wrap=True), Column("unknowns", no_wrap=True)
    sizes = Column("sizes", no_wrap=True)
    table = Table(names, "problem", keys, sizes, title="isas run scene=NAME size=SIZE")
    for name in method.options("scene"):
        node = method.whole(name)
        unknowns = "\n".join(node.get("unknowns") or {}) or "scene.unknowns=…"
        problem = node.get("description") or ""
        own = method.flat(method.said(name, "method"))
        if words := [f"{group}={own[group]}" for group in ("estimator", "sampler") if group in own]:
            problem += f" Takes {' '.join(words)}."
        row = name, problem, unknowns, "\n".join(node.get("sizes") or [])
        table.add_row(*map(Text, row))  # as they are written
    console.print(table)
    for group in ("sampler", "loss"):
        table = Table(group, "what it does", title=f"{group}=NAME")
        for name, file in searchpath.files(group).items():
            table.add_row(*map(Text, (name, _comment(file.read_text(encoding="utf-8")))))
        console.print(table)
    return 0
