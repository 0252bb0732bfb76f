"""Whether Dr.Jit can freeze kernels that trace a scene, found out by trying."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..runtime import memory
from ..runtime.backend import sync
from ..runtime.errors import InputError
from ..scene.problem import Problem
from .coverage import Pass, replayed
from .integrators import root
from .renderer import Renderer

_LANES = 64
_CALLS = 3  # the first records, the second may again, the third runs what was recorded


def look(problem: Problem, where: str) -> None:
    """Set ``problem.freezes`` by tracing a few of its pixels, with derivatives, and warn of what it
    costs where it is False. Leaves the unknowns at their starts; ``where`` names the scene.

    Dr.Jit records the arrays that it finds in a kernel's arguments. Some of Mitsuba's plugins show
    it none of theirs, and a kernel that uses them raises, mostly at its end: it has added to
    gradients by then, and cannot be run again. So it is found out where nothing counts. First the
    kernel runs without being frozen: some plugins make arrays when they are first used, as a
    textured lamp does, and these must be there when a recording begins.

    Raises InputError where not even that works: Mitsuba cannot trace the scene; and what says that
    memory is full.
    """
    unknowns = problem.unknowns
    differentiated = {u.key: u.start for u in replayed(problem)}

    def seconds(tried: Problem) -> float:
        """Of the quickest of a few calls."""
        run, spent = _traced(tried, bool(differentiated)), []
        for _ in range(_CALLS):
            unknowns.attach(unknowns.values_of(differentiated))
            sync()
            begun = time.perf_counter()
            run()
            sync()
            spent.append(time.perf_counter() - begun)
        return min(spent)

    unknowns.write(unknowns.starts())
    try:
        anew = seconds(replace(problem, freezes=False))
    except RuntimeError as error:
        if memory.exhausted(error):
            raise
        raise untraceable(where, error) from error
    try:
        seconds(problem)
    except RuntimeError as error:
        if memory.exhausted(error):
            raise
        problem.freezes = False
        problem.warnings.append(
            "kernels of this scene cannot be frozen, as a plugin hides arrays from Dr.Jit: each is "
            f"traced anew at every call, which costs about {max(1, round(1000 * anew))} ms of "
            "billed time; results are the same"
        )
    finally:
        unknowns.write(unknowns.starts())


def _traced(problem: Problem, differentiated: bool) -> Callable[[], None]:
    if differentiated:
        run, apart = Pass(problem, _LANES), problem.views.total / _LANES
        return lambda: run(0, apart, 0, False)
    renderer = Renderer(problem)
    pixel = dr.arange(mi.UInt32, min(_LANES, problem.views.total))
    return lambda: renderer.pixels(pixel, 1, lambda sample: sample)


def untraceable(where: str, error: RuntimeError) -> InputError:
    """That Mitsuba cannot trace the scene, in what was said first in a chain of errors."""
    first = str(root(error)).strip().splitlines()[0]
    way = "; isas renders red, green and blue: give such a colour as <rgb …>"
    way = way if "spectral" in first else ""
    return InputError(f"{where}: Mitsuba cannot trace paths through it: {first}{way}")
