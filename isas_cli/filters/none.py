"""No filter."""

from __future__ import annotations

from dataclasses import dataclass

from .filter import Filter, Layout, OnUnknown


@dataclass(frozen=True)
class Nothing(Filter):
    """Adam's step, entry by entry."""

    name = "none"

    def on(self, layout: Layout, β: tuple[float, float], masked: bool) -> OnUnknown:
        return OnUnknown(layout)
