"""Integrator "emission" of a scene's description. Importing it needs a variant
(``backend.plugin``)."""

from __future__ import annotations

import mitsuba as mi
from mitsuba.python.ad.integrators.common import RBIntegrator


class Emission(RBIntegrator):
    """Its medium emits and absorbs (``volume.emitted``), and the albedo is the radiance that it
    emits. Itself it renders nothing. ``strange``: what it was given that means nothing to it."""

    hide_emitters = False

    def __init__(self, props: mi.Properties):
        names = ("max_depth", "rr_depth", "hide_emitters")
        strange = [name for name in names if name in props]
        super().__init__(props)
        self.strange = strange
        self.max_depth, self.rr_depth = 1, 2**32 - 1  # nothing scatters


mi.register_integrator("emission", Emission)
