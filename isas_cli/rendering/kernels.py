"""Kernels that are recorded once, or traced at every call, with the same sums in both cases."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr


def recorded(kernel: Callable, freeze: bool) -> Callable:
    """``kernel`` frozen (``dr.freeze``), or as it is.

    Derivatives leave it when it ends, as they leave a frozen one. Passes within it that each
    followed a texture to its leaf would lose part of what they add: a scatter into an array that
    has one pending expands it for all threads before it evaluates what it adds, which reduces the
    array again, and what is added then by any thread but the first is never counted (Dr.Jit 1.5,
    LLVM).

    Where it is called with ``sizes``, a tuple of numbers, each has a recording of its own: those of
    arrays that are differentiated by, or over which it runs, are compiled into it.
    """

    def sized(*arguments, sizes: tuple[int, ...] = ()):
        return kernel(*arguments)

    if freeze:
        return dr.freeze(sized)

    def isolated(*arguments, sizes: tuple[int, ...] = ()):
        with dr.isolate_grad():
            return kernel(*arguments)

    return isolated
