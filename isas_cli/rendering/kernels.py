"""Kernels that are recorded once, or traced at every call, with the same sums in both cases."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

if TYPE_CHECKING:
    from ..scene.problem import Problem


def recorded(kernel: Callable, problem: Problem | None, freeze: bool = True) -> Callable:
    """``kernel`` frozen (``dr.freeze``), or as it is: where ``freeze`` says so, and where Dr.Jit
    cannot record what the scene of ``problem`` holds (``Problem.freezes``). ``problem``: None for
    kernels over plain arrays.

    Derivatives leave it when it ends, as they leave a frozen one. Passes within it that each
    followed a texture to its leaf would lose part of what they add: a scatter into an array that
    has one pending expands it for all threads before it evaluates what it adds, which reduces the
    array again, and what is added then by any thread but the first is never counted (Dr.Jit 1.5,
    LLVM).

    Sizes of arrays that are differentiated by, or run over, change between calls; they are compiled
    in, so each has a recording of its own (``Unknowns.sizes``).
    """
    if not freeze or (problem is not None and not problem.freezes):
        return isolated(kernel)
    if problem is None:
        return dr.freeze(kernel)
    unseen = hidden(problem.scene)
    return dr.freeze(kernel, state_fn=lambda *arguments: (problem.unknowns.sizes(), unseen()))


def isolated(kernel: Callable) -> Callable:
    """``kernel`` traced at every call; derivatives leave it when it ends."""

    def run(*arguments):
        with dr.isolate_grad():
            return kernel(*arguments)

    return run


def hidden(scene: mi.Scene) -> Callable[[], list]:
    """A function that gives the present arrays which kernels use and Dr.Jit does not find when it
    looks through the scene for what a recording depends on: phase functions show it none of
    theirs. Those that Mitsuba does not show either remain: see ``trial``."""
    params = mi.traverse(scene)
    keys = [
        key
        for key in params.keys()
        if "phase_function" in key.split(".") and dr.is_jit_v(params[key])
    ]
    return lambda: [dr.detach(params[key]) for key in keys]
