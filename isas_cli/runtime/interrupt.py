"""Ctrl-C that lets the record be finished first, and Ctrl-Z that is not billed."""

from __future__ import annotations

import functools
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import psutil

# The exit status after Ctrl-C, as shells have it: 128 + SIGINT.
STATUS = 130
# What asks a process to end; SIGHUP: its terminal is gone.
_ASKING = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
# Within so many seconds a second signal is the first: what stops a whole group of processes may
# come by itself and be passed on as well.
once_seconds = 1.0
# Times that jobs which may stand still are sent on.
_AGAIN = 10

_asked = False


@contextmanager
def graceful(notice: Callable[[], None] = lambda: None) -> Iterator[Callable[[], bool]]:
    """Within the context SIGINT, SIGTERM and SIGHUP only set a flag; the yielded function reads it.

    A step cut in half would leave parameters and moments of different iterations. ``notice`` is
    called when the flag is first read as set (not by the handler, which may come in the middle of
    another print); a second signal, ``once_seconds`` later, interrupts at once. SIGTSTP, Ctrl-Z,
    suspends the process when the function is next called: between steps, where no clock runs; not
    where SIGCONT came after it.
    """
    noticed, held, again = False, False, 0
    wanted: float | None = None  # since when

    def ask(number, frame) -> None:
        global _asked
        nonlocal wanted
        now = time.monotonic()
        if wanted is None:
            wanted = now
        elif now - wanted > once_seconds:
            _asked = True
            raise KeyboardInterrupt

    def stop() -> bool:
        nonlocal noticed, held, again
        check()
        for number in came():
            if number in (signal.SIGTSTP, signal.SIGCONT):
                held = number == signal.SIGTSTP
        if held:
            held = False
            # Jobs of a sweep are in groups of their own, which a terminal does not reach.
            jobs = psutil.Process().children()
            _send(jobs, signal.SIGTSTP)
            if signal.SIGCONT not in came():
                # To this thread, which is to do nothing more before all of them stand still.
                signal.pthread_kill(threading.get_ident(), signal.SIGSTOP)
            again = _AGAIN
        if again:  # one may have read the first of both, and not stand still yet
            again -= 1
            _send(psutil.Process().children(), signal.SIGCONT)
        if wanted is not None and not noticed:
            noticed = True
            notice()
        return wanted is not None

    with _ordered() as came, _handled(dict.fromkeys(_ASKING, ask)):
        yield stop


@contextmanager
def _ordered() -> Iterator[Callable[[], bytes]]:
    """Within the context SIGTSTP and SIGCONT do nothing; the yielded function gives the numbers of
    all signals since its last call, in their order. Handlers of those that come in the middle of a
    kernel are called in the order of their numbers."""
    if threading.current_thread() is not threading.main_thread():
        yield bytes
        return
    source, sink = _pipe()

    def came() -> bytes:
        with suppress(BlockingIOError):
            return os.read(source, 1 << 16)
        return b""

    def nothing(number, frame) -> None:
        pass

    came()  # of an earlier context
    before = signal.set_wakeup_fd(sink, warn_on_full_buffer=False)
    try:
        with _handled({signal.SIGTSTP: nothing, signal.SIGCONT: nothing}):
            yield came
    finally:
        signal.set_wakeup_fd(before)


@functools.cache
def _pipe() -> tuple[int, int]:
    """Stays open: threads of a sweep may ask for longer than its context lasts."""
    ends = os.pipe()
    for end in ends:
        os.set_blocking(end, False)
    return ends


def _send(jobs: list[psutil.Process], number: int) -> None:
    for job in jobs:
        with suppress(psutil.NoSuchProcess):
            job.send_signal(number)


@contextmanager
def prompt() -> Iterator[None]:
    """Within the context SIGINT, SIGTERM and SIGHUP raise KeyboardInterrupt, wherever that is.

    An exception that happens to be raised inside a callback of Dr.Jit's, or while an object is
    deleted, may come out as another one, which is raised as what it was, or not at all: ``asked``
    says so, and ``check`` raises it again.
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
        with _handled(dict.fromkeys(_ASKING, interrupt)):
            yield
    except Exception:
        check()
        raise
    finally:
        sys.unraisablehook = hook


@contextmanager
def held() -> Iterator[None]:
    """Within the context SIGINT, SIGTERM and SIGHUP wait for its end: what is changed there in
    several steps is changed as a whole or not at all."""
    noted: list[int] = []

    def note(number, frame) -> None:
        noted.append(number)

    with _handled(dict.fromkeys(_ASKING, note)):
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
    # What a program that Python is embedded in has put there could not be put back; under nohup a
    # terminal's end stays ignored.
    kept = {number: signal.getsignal(number) for number in handlers}
    own = [n for n, before in kept.items() if before is not None]
    if kept.get(signal.SIGHUP) == signal.SIG_IGN:
        own.remove(signal.SIGHUP)
    previous = {number: signal.signal(number, handlers[number]) for number in own}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
