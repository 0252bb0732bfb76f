"""Ctrl-C that lets the record be finished first, and Ctrl-Z that is not billed."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import psutil

# The exit status after Ctrl-C, as shells have it: 128 + SIGINT.
STATUS = 130

_asked = False


@contextmanager
def graceful(notice: Callable[[], None] = lambda: None) -> Iterator[Callable[[], bool]]:
    """Within the context SIGINT and SIGTERM only set a flag; the yielded function reads it.

    A step cut in half would leave parameters and moments of different iterations. ``notice`` is
    called when the flag is first read as set (not by the handler, which may come in the middle of
    another print); the second signal interrupts at once. SIGTSTP, Ctrl-Z, suspends the process when
    the function is next called: between steps, where no clock runs.
    """
    wanted = noticed = held = False
    jobs: list[psutil.Process] = []

    def ask(number, frame) -> None:
        global _asked
        nonlocal wanted
        if wanted:
            _asked = True
            raise KeyboardInterrupt
        wanted = True

    def hold(number, frame) -> None:
        nonlocal held
        held = True

    def stop() -> bool:
        nonlocal noticed, held
        check()
        if held:
            held = False
            # Jobs of a sweep are in groups of their own, which a terminal does not reach.
            jobs[:] = psutil.Process().children()
            _send(jobs, signal.SIGTSTP)
            os.kill(os.getpid(), signal.SIGSTOP)
        # Again and again: one in the middle of a step suspends itself only after it.
        _send(jobs, signal.SIGCONT)
        if wanted and not noticed:
            noticed = True
            notice()
        return wanted

    with _handled({signal.SIGINT: ask, signal.SIGTERM: ask, signal.SIGTSTP: hold}):
        yield stop


def _send(jobs: list[psutil.Process], number: int) -> None:
    for job in jobs:
        with suppress(psutil.NoSuchProcess):
            job.send_signal(number)


@contextmanager
def prompt() -> Iterator[None]:
    """Within the context SIGINT and SIGTERM raise KeyboardInterrupt, wherever that is.

    An exception that happens to be raised inside a callback of Dr.Jit's, or while an object is
    deleted, may come out as another one or not at all: ``asked`` says what it was, and ``check``
    raises it again.
    """
    global _asked
    _asked = False

    def interrupt(number, frame) -> None:
        global _asked
        _asked = True
        raise KeyboardInterrupt

    hook = sys.unraisablehook

    def quiet(lost) -> None:
        if lost.exc_type is not KeyboardInterrupt:
            hook(lost)

    sys.unraisablehook = quiet
    try:
        with _handled({signal.SIGINT: interrupt, signal.SIGTERM: interrupt}):
            yield
    finally:
        sys.unraisablehook = hook


@contextmanager
def held() -> Iterator[None]:
    """Within the context SIGINT and SIGTERM wait for its end: what is changed there in several
    steps is changed as a whole or not at all."""
    noted: list[int] = []

    def note(number, frame) -> None:
        noted.append(number)

    with _handled({signal.SIGINT: note, signal.SIGTERM: note}):
        yield
    if noted:
        signal.raise_signal(noted[0])


def asked() -> bool:
    """Whether the present or last command got a signal that should have ended it at once."""
    return _asked


def check() -> None:
    """Raise the KeyboardInterrupt that got lost on its way, if one did."""
    if _asked:
        raise KeyboardInterrupt


@contextmanager
def _handled(handlers: dict) -> Iterator[None]:
    # Python takes signals in its main thread only; elsewhere they keep their meaning.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
