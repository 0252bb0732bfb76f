"""A scene builder for sweeps some of whose jobs end badly: the texture's size says how."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path

from isas_cli.scenes import dodoco

from isas_cli.runtime.errors import InputError

REFUSED, RAISES, KILLED, KILLS_PARENT = 9, 10, 11, 12


def build(views: int, resolution: int, texture: int) -> dict:
    if texture == REFUSED:
        raise InputError("this scene is refused")
    if texture == RAISES:
        raise RuntimeError("this scene is\nbroken")
    if texture == KILLED:
        os.kill(os.getpid(), signal.SIGKILL)
    if texture == KILLS_PARENT:
        with contextlib.suppress(FileExistsError):
            Path("once").touch(exist_ok=False)
            os.kill(os.getppid(), signal.SIGKILL)
            time.sleep(60)
    return dodoco.build(views, resolution, texture)
