"""Ctrl-C that lets the record be finished first."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def graceful() -> Iterator[Callable[[], bool]]:
    """Within the context SIGINT and SIGTERM only set a flag; the yielded function reads it.

    A step cut in half would leave parameters and moments of different iterations. The second
    Ctrl-C interrupts at once.
    """
    asked = False

    def ask(number, frame) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    previous = {s: signal.signal(s, ask) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: asked
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
