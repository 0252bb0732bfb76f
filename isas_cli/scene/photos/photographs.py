"""All that is known before a renderer is asked: cameras, pictures, the object."""

from __future__ import annotations

from dataclasses import dataclass

from ...config.schema import PhotosConfig
from ...scenes.meshes import Surface
from . import importing, reading, shape
from .base import Capture
from .importing import Photograph


@dataclass
class Photographs:
    """``shown``: views to learn from, at least one; ``held``: views held out; ``capture``: all that
    their file says; ``surface``: of the object; ``settings``: what was asked for."""

    shown: list[Photograph]
    held: list[Photograph]
    capture: Capture
    surface: Surface | None
    settings: PhotosConfig

    @property
    def all(self) -> list[Photograph]:
        return [*self.shown, *self.held]


def load(settings: PhotosConfig, shapeless: bool = False) -> Photographs:
    """Read and resample. ``shapeless``: whether there may be no object. Raises InputError for all
    that is wrong with cameras, pictures, object."""
    capture = reading.read(settings.path, settings.test, settings.cameras, settings.world)
    shown, held = reading.split(capture, settings.test)
    surface = None
    if not shapeless or shape.described(settings, capture):
        surface = shape.surface(settings, capture)
    made = [[importing.load(camera, settings) for camera in part] for part in (shown, held)]
    return Photographs(*made, capture, surface, settings)
