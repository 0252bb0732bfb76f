"""Mitsuba's whole images through a film whose pixels are what targets are."""

from __future__ import annotations

import mitsuba as mi


class OwnFilm:
    """A sensor of the scene before a film of its own: of its crop window's size, its pixels the
    means over their squares, linear red, green and blue; and with an independent sampler, which
    takes any number of samples a pixel, where others round it up. The scene's film and sampler stay
    as they are.

    Where the window lies is in the sensor's projection already. Mitsuba's projective integrators
    put samples of silhouettes where they lie in the window, and a film with an offset would take
    them for places in the whole image.

    For Mitsuba's integrators that are written in Python, which ask a sensor by name for all that
    they need of it, and for ``mi.render``. Not registered with Dr.Jit as one of its sensors: those
    of a class in Python would be asked for every ray of all others as well.
    """

    # ``mi.render`` and the integrators take nothing else.
    __class__ = property(lambda self: mi.Sensor)

    def __init__(self, sensor: mi.Sensor):
        width, height = map(int, sensor.film().crop_size())
        self._sensor, self._sampler = sensor, mi.load_dict({"type": "independent"})
        self._film = mi.load_dict(
            {
                **{"type": "hdrfilm", "width": width, "height": height},
                "rfilter": {"type": "box"},
                **{"pixel_format": "rgb", "component_format": "float32"},
            }
        )

    def film(self) -> mi.Film:
        return self._film

    def sampler(self) -> mi.Sampler:
        return self._sampler

    def __getattr__(self, name: str):
        return getattr(self._sensor, name)

    def __repr__(self) -> str:
        # By which the projective integrators tell a perspective camera.
        return repr(self._sensor)
