"""A scene builder for sweeps some of whose jobs end badly: the texture's size says how."""

from __future__ import annotations

import os
import signal

from isas_cli.scenes import dodoco

from isas_cli.runtime.errors import InputError

REFUSED, RAISES, KILLED = 9, 10, 11


def build(views: int, resolution: int, texture: int) -> dict:
    if texture == REFUSED:
        raise InputError("this scene is refused")
    if texture == RAISES:
        raise RuntimeError("this scene is\nbroken")
    if texture == KILLED:
        os.kill(os.getpid(), signal.SIGKILL)
    return dodoco.build(views, resolution, texture)
