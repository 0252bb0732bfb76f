"""Renderers that isas knows nothing of: a Python function, or a command that writes an EXR."""

from __future__ import annotations

import hashlib
import inspect
import shlex
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..config.schema import ExternalConfig
from ..runtime import allowed, images
from ..runtime.errors import InputError

# Pictures that are kept: of the values now, of both of a pair, and of the truth.
_KEPT = 6
# What a command may name beside its parameters.
_OWN = ("out", "seed", "view", "width", "height")


class Outside:
    """``values``: of the parameters now, float32, by name; ``sizes``: of the films."""

    def __init__(self, settings: ExternalConfig):
        self.settings = settings
        self.values = {k: np.array(v, np.float32) for k, v in settings.parameters.items()}
        height = settings.height or settings.width
        self.sizes = [(settings.width, height)] * settings.views
        self._render = self._called() if settings.function else self._commanded()
        self._pictures: dict[tuple, np.ndarray] = {}

    def picture(self, view: int, seed: int) -> np.ndarray:
        """``(H, W, 3) float32``, linear, at the present values. Raises InputError for what is no
        such picture."""
        seed = seed if self.settings.noisy else 0
        key = view, seed, *(value.tobytes() for value in self.values.values())
        if key not in self._pictures:
            while len(self._pictures) >= _KEPT * len(self.sizes):
                del self._pictures[next(iter(self._pictures))]
            self._pictures[key] = self._checked(self._render(view, seed))
        return self._pictures[key]

    def description(self) -> str:
        """What its pictures depend on: the settings, its files, and one picture of each view."""
        hashed = hashlib.blake2b(digest_size=16)
        for view in range(len(self.sizes)):
            hashed.update(self.picture(view, 0).tobytes())
        own = self.settings
        files = [Path(word) for word in shlex.split(own.command or "")]
        for file in (each for each in files if each.is_file() and each.suffix):
            hashed.update(file.read_bytes())
        return f"{own} {hashed.hexdigest()}"

    @property
    def where(self) -> str:
        name = "function" if self.settings.function else "command"
        return f"scene.external.{name}={getattr(self.settings, name)}"

    def _checked(self, picture) -> np.ndarray:
        found = np.asarray(picture, np.float32)
        (width, height) = self.sizes[0]
        if found.shape != (height, width, 3):
            raise InputError(
                f"{self.where} gives {found.shape}, not {(height, width, 3)}, rows, columns and "
                "channels: scene.external.width and .height say how large pictures are"
            )
        return found

    def _called(self) -> Callable[[int, int], np.ndarray]:
        if (here := str(Path.cwd())) not in sys.path:
            sys.path.append(here)  # last, so that it takes no other module's place
        function = allowed.named(self.settings.function, "isas_cli", "scene.external.function")
        wanted = ["parameters", "seed", "view"]
        if list(inspect.signature(function).parameters) != wanted:
            raise InputError(f"{self.where}: is to be called with ({', '.join(wanted)})")

        def call(view: int, seed: int) -> np.ndarray:
            values = {key: value.copy() for key, value in self.values.items()}
            try:
                return function(values, seed, view)
            except Exception as error:
                *_, last = traceback.extract_tb(error.__traceback__)
                raise InputError(
                    f"{self.where}: raises {error!r} ({last.filename}:{last.lineno})"
                ) from error

        return call

    def _commanded(self) -> Callable[[int, int], np.ndarray]:
        try:
            words = shlex.split(self.settings.command)
        except ValueError as error:
            raise InputError(f"{self.where}: {error}") from error
        allowed.program(words[0] if words else "", self.where)
        return self._run

    def _run(self, view: int, seed: int) -> np.ndarray:
        (width, height) = self.sizes[0]
        with tempfile.TemporaryDirectory(prefix="isas-external-") as folder:
            out = Path(folder) / "out.exr"
            own = dict(zip(_OWN, (out, seed, view, width, height)))
            told = {k: ",".join(map(repr, map(float, v.ravel()))) for k, v in self.values.items()}
            try:
                words = [w.format(**told, **own) for w in shlex.split(self.settings.command)]
                done = subprocess.run(words, capture_output=True, text=True)
            except (KeyError, IndexError, ValueError, OSError) as error:
                valid = ", ".join(f"{{{name}}}" for name in (*self.values, *_OWN))
                raise InputError(
                    f"{self.where}: cannot be run ({error!r}); valid in it: {valid}"
                ) from error
            if done.returncode or not out.is_file():
                last = (done.stderr.strip().splitlines() or ["nothing on standard error"])[-1]
                why = f"ends with {done.returncode}" if done.returncode else "writes no {out}"
                raise InputError(f"{self.where}: {why}: {last}")
            return images.read(out, finite=False)


def description(outside: Outside) -> dict:
    """A scene of as many films, for ``mitsuba.load_dict``: nothing of it is rendered."""
    return {
        "type": "scene",
        "integrator": {"type": "prb"},
        "light": {"type": "constant"},
        **{
            f"sensor_{number:05d}": {
                "type": "perspective",
                "film": {"type": "hdrfilm", "width": width, "height": height},
            }
            for number, (width, height) in enumerate(outside.sizes)
        },
    }
