"""Renderers that isas knows nothing of: a Python function, or a command that writes an EXR."""

from __future__ import annotations

import hashlib
import inspect
import re
import shlex
import subprocess
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
_EXR = b"\x76\x2f\x31\x01"
_OWN = ("out", "seed", "view", "width", "height")


class Outside:
    """``values``: of the parameters now, float32, by name; ``sizes``: of the films; ``warnings``:
    what should be said of the first file that a command wrote."""

    def __init__(self, settings: ExternalConfig):
        self.settings = settings
        self.values = {k: np.array(v, np.float32) for k, v in settings.parameters.items()}
        height = settings.height or settings.width
        self.sizes = [(settings.width, height)] * settings.views
        self._render = self._called() if settings.function else self._commanded()
        self._pictures: dict[tuple, np.ndarray] = {}
        self.warnings: list[str] = []
        self._unasked = True

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
        for file in (each for each in files if each.is_file()):
            hashed.update(file.read_bytes())
        return f"{own} {hashed.hexdigest()}"

    @property
    def where(self) -> str:
        name = "function" if self.settings.function else "command"
        return f"scene.external.{name}={getattr(self.settings, name)}"

    def _checked(self, picture) -> np.ndarray:
        picture = np.asarray(picture)
        if picture.dtype.kind != "f":
            raise InputError(
                f"{self.where} gives {picture.dtype}: linear pixels as floats are wanted"
            )
        found = picture.astype(np.float32)
        (width, height) = self.sizes[0]
        if found.shape != (height, width, 3):
            raise InputError(
                f"{self.where} gives {found.shape}, not {(height, width, 3)}, rows, columns and "
                "channels: scene.external.width and .height say how large pictures are"
            )
        if not np.isfinite(found).all():
            row, column, _ = np.argwhere(~np.isfinite(found))[0]
            now = {key: value.tolist() for key, value in self.values.items()}
            raise InputError(
                f"{self.where} gives {found[row, column].tolist()} in row {row}, column {column}, "
                f"with {now}"
            )
        return found

    def _called(self) -> Callable[[int, int], np.ndarray]:
        function = allowed.named(self.settings.function, "isas_cli", "scene.external.function")
        if not callable(function):
            raise InputError(f"{self.where}: is no function")
        try:
            inspect.signature(function).bind({}, 0, 0)
        except TypeError as error:
            raise InputError(
                f"{self.where}: is called as render(parameters, seed, view): {error}"
            ) from error
        except ValueError:  # of a compiled one
            pass

        def call(view: int, seed: int) -> np.ndarray:
            values = {key: value.copy() for key, value in self.values.items()}
            try:
                return function(values, seed, view)
            except (Exception, SystemExit) as error:
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
            told = {k: ",".join(map(repr, map(float, v.ravel()))) for k, v in self.values.items()}
            told |= {k: str(v) for k, v in zip(_OWN, (out, seed, view, width, height))}
            words = [self._filled(word, told) for word in shlex.split(self.settings.command)]
            try:
                # Of its own: Ctrl-C is for isas, which ends it.
                done = subprocess.run(
                    words, capture_output=True, text=True, errors="replace", start_new_session=True
                )
            except OSError as error:
                raise InputError(f"{self.where}: {words[0]}: {error.strerror}") from error
            last = (done.stderr.strip().splitlines() or ["nothing on standard error"])[-1]
            if done.returncode:
                raise InputError(f"{self.where}: ends with {done.returncode}: {last}")
            if not out.is_file() or out.open("rb").read(len(_EXR)) != _EXR:
                raise InputError(f"{self.where}: writes no EXR as {{out}}: {last}")
            picture = images.load(out, finite=False)
            if self._unasked:
                self._unasked = False
                found = images.unheeded([out], [picture.doubt])
                said = [line.replace(str(out), "{out}") for line in found]
                self.warnings = [f"{self.where}: {line}" for line in said]
            return picture.image

    def _filled(self, word: str, told: dict[str, str]) -> str:
        def value(found: re.Match) -> str:
            if found[1] not in told:
                valid = ", ".join(f"{{{name}}}" for name in told)
                raise InputError(f"{self.where}: {found[0]}: valid in it: {valid}")
            return told[found[1]]

        return re.sub(r"\{([^{}]*)\}", value, word)


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
