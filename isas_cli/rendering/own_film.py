"""Mitsuba's whole images through a film whose pixels are what targets are."""

from __future__ import annotations

import mitsuba as mi


class OwnFilm:
    """A sensor of the scene before a film of its own: of the same size and crop window, its pixels
    the means over their squares, linear red, green and blue. The scene's film stays as it is.

    For Mitsuba's integrators that are written in Python, which ask a sensor by name for all that
    they need of it, and for ``mi.render``. Not registered with Dr.Jit as one of its sensors: those
    of a class in Python would be asked for every ray of all others as well.
    """

    # ``mi.render`` and the integrators take nothing else.
    __class__ = property(lambda self: mi.Sensor)

    def __init__(self, sensor: mi.Sensor):
        film = sensor.film()
        width, height = map(int, film.size())
        crop = (int(n) for pair in (film.crop_offset(), film.crop_size()) for n in pair)
        words = "crop_offset_x", "crop_offset_y", "crop_width", "crop_height"
        self._sensor = sensor
        self._film = mi.load_dict(
            {
                **{"type": "hdrfilm", "width": width, "height": height, **dict(zip(words, crop))},
                "rfilter": {"type": "box"},
                **{"pixel_format": "rgb", "component_format": "float32"},
            }
        )

    def film(self) -> mi.Film:
        return self._film

    def __getattr__(self, name: str):
        return getattr(self._sensor, name)

    def __repr__(self) -> str:
        # By which the projective integrators tell a perspective camera.
        return repr(self._sensor)
