"""Rows that a measuring process hands to the one that started it, on standard output.

Mitsuba warns there as well, and what resets the warning's colour stands before whatever is printed
next: a row is found by its mark, not by how its line begins.
"""

from __future__ import annotations

import json
import subprocess

_MARK = "ROW: "


def emit(row: dict) -> None:
    print(_MARK + json.dumps(row), flush=True)


def read(text: str) -> list[dict]:
    """The rows in what a process printed."""
    return [json.loads(line.partition(_MARK)[2]) for line in text.splitlines() if _MARK in line]


def collect(command: list[str]) -> list[dict]:
    """The rows of ``command``; ends this process where it fails."""
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        raise SystemExit(done.returncode)
    return read(done.stdout)
