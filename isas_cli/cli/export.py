"""`isas export`: a run's result as a scene that Mitsuba renders by itself, and as glTF."""

from __future__ import annotations

from pathlib import Path

from ..engine import resumption
from ..engine.display import say
from ..runtime import backend, interrupt


def main(folder: Path, output: Path | None) -> int:
    """Write the result of the run in ``folder`` into ``output`` (None: ``folder/result``). Raises
    InputError; returns 0."""
    typed, arrays = resumption.result(folder)
    with interrupt.prompt():
        backend.start(typed.variant, typed.threads)
        from ..scene import export

        if told := resumption.changed_since(folder, typed):
            say(told)
        path, told = export.write(typed.scene, arrays, output or folder / "result")
    glb = path.with_suffix(".glb")
    print(f"result: {path}", *[f"glTF: {glb}"] * glb.exists(), *told, sep="\n")
    return 0
