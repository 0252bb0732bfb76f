"""Single values, colours and lists of numbers: whatever Mitsuba itself differentiates."""

from __future__ import annotations

import mitsuba as mi

from . import routes
from .kind import Kind, Loaded
from .parameters import is_differentiable, is_grid, moves_geometry


class Value(Kind):
    """A parameter that is not more than its numbers: nothing to picture, no neighbours."""

    name = "value"

    @classmethod
    def matches(cls, params: mi.SceneParameters, key: str) -> bool:
        return (
            is_differentiable(params, key)
            and not moves_geometry(params, key)
            # Its numbers have places in space, of which nothing here knows.
            and not is_grid(params, key)
        )

    def __init__(self, key: str, loaded: Loaded):
        super().__init__(key, loaded)
        self.aside = routes.aside(loaded.params, key)
        self.carried = not self.aside

    def warnings(self) -> list[str]:
        if not self.aside:
            return []
        count = self.present.size
        return [
            f"'{self.key}': {self.aside}: differences of renderings are taken, {2 * count} more "
            "paths a pixel, and the tables made anew for each"
        ]
