"""Kernels that are recorded once, or traced at every call, with the same sums in both cases."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr


def recorded(
    kernel: Callable, freeze: bool, sizes: Callable[[], tuple[int, ...]] | None = None
) -> Callable:
    """``kernel`` frozen (``dr.freeze``), or as it is.

    Derivatives leave it when it ends, as they leave a frozen one. Passes within it that each
    followed a texture to its leaf would lose part of what they add: a scatter into an array that
    has one pending expands it for all threads before it evaluates what it adds, which reduces the
    array again, and what is added then by any thread but the first is never counted (Dr.Jit 1.5,
    LLVM).

    ``sizes``: of arrays that it differentiates by, or runs over, and that change between calls;
    they are compiled in, so each has a recording of its own (``Unknowns.sizes``).
    """
    if freeze:
        return dr.freeze(kernel, state_fn=sizes and (lambda *arguments: sizes()))

    def isolated(*arguments):
        with dr.isolate_grad():
            return kernel(*arguments)

    return isolated
