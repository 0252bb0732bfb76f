"""What is billed, what is not, and when the clock may be read."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

from .backend import sync


class Clock:
    """Seconds by phase, billed and unbilled apart.

    Dr.Jit launches work and returns: a clock read without waiting times the launch. Both ends of
    every phase therefore wait until all work queued so far is done, so that no phase pays for
    another's. Billed: what a user of the method cannot do without (refreshing the distribution,
    rendering, back-propagation, the step, projection). Unbilled: loading, targets, compiling,
    evaluation, writing, each under its own name.
    """

    def __init__(self) -> None:
        self.billed_seconds: dict[str, float] = defaultdict(float)
        self.unbilled_seconds: dict[str, float] = defaultdict(float)

    @contextmanager
    def _phase(self, account: dict[str, float], name: str) -> Iterator[None]:
        sync()
        start = time.perf_counter()
        try:
            yield
        finally:
            sync()
            account[name] += time.perf_counter() - start

    def billed(self, name: str):
        return self._phase(self.billed_seconds, name)

    def unbilled(self, name: str):
        return self._phase(self.unbilled_seconds, name)

    @property
    def seconds(self) -> float:
        """All billed seconds so far."""
        return sum(self.billed_seconds.values())
