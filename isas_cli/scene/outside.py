"""Renderers that isas knows nothing of: a Python function, or a command that writes an EXR."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import os
import re
import shlex
import signal
import subprocess
import tempfile
import traceback
from collections.abc import Callable, Container
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..config.schema import ExternalConfig
from ..runtime import allowed, images
from ..runtime.errors import InputError

# Pictures that are kept: of the values now, of both of a pair, and of the truth.
_KEPT = 6
# What a command may name beside its parameters.
_EXR = b"\x76\x2f\x31\x01"
_LONG = 100  # letters of a parameter's value in a message
_OWN = ("out", "seed", "view", "width", "height")


class Failed(InputError):
    """The renderer gave no picture."""


class Outside:
    """``values``: of the parameters now, by name, float32 of those that are ``unknown``, others as
    they are given; ``sizes``: of the films; ``warnings``: what should be said of its pictures."""

    def __init__(self, settings: ExternalConfig, unknown: Container[str] = ()):
        self.settings = settings
        self.values = {
            name: np.array(value, np.float32) if name in unknown else _given(value)
            for name, value in settings.parameters.items()
        }
        height = settings.height or settings.width
        self.sizes = [(settings.width, height)] * settings.views
        self._render = self._called() if settings.function else self._commanded()
        self._pictures: dict[tuple, np.ndarray] = {}
        self.warnings: list[str] = []
        self._unasked = True

    def picture(self, view: int, seed: int) -> np.ndarray:
        """``(H, W, 3) float32``, linear, at the present values. Raises Failed for what is no such
        picture, when tried again either where there is noise."""
        seed = seed if self.settings.noisy else 0
        key = view, seed, *(value.tobytes() for value in self.values.values())
        if key not in self._pictures:
            while len(self._pictures) >= _KEPT * len(self.sizes):
                del self._pictures[next(iter(self._pictures))]
            self._pictures[key] = self._tried(view, seed)
        return self._pictures[key]

    def _tried(self, view: int, seed: int) -> np.ndarray:
        try:
            return self._checked(self._render(view, seed))
        except Failed:
            if not self.settings.noisy:
                raise
            # Those of seed 0 are compared with each other.
            return self._checked(self._render(view, seed and seed ^ 1))

    def description(self) -> str:
        """What its pictures depend on: the settings, and one picture of each view where the same
        seed gives the first one again. Raises Failed, also for pixels that are not finite."""
        hashed, same = hashlib.blake2b(digest_size=16), True
        for view in range(len(self.sizes)):
            picture = self.picture(view, 0)
            if not np.isfinite(picture).all():
                row, column, _ = np.argwhere(~np.isfinite(picture))[0]
                shown = picture[row, column].tolist()
                raise self._failed(f"gives {shown} in row {row}, column {column}")
            hashed.update(picture.tobytes())
            if view == 0:
                same = self._tried(0, 0).tobytes() == picture.tobytes()
        if not same:
            cure = "" if self.settings.noisy else "; external.noisy=true averages targets"
            self.warnings.append(
                f"{self.where}: the same seed gives another picture: noise does not cancel between "
                f"pictures of one seed, and a change of the renderer is not noticed{cure}"
            )

        def told(word: str) -> str:
            """Gone on with from elsewhere, files may have other folders, where pictures tell."""
            if not os.path.isfile(word):
                return word
            return Path(word).name if same else os.path.realpath(word)

        command = self.settings.command
        names = command and shlex.join(map(told, shlex.split(command)))
        return f"{replace(self.settings, command=names)} {hashed.hexdigest() if same else ''}"

    @property
    def where(self) -> str:
        name = "function" if self.settings.function else "command"
        return f"scene.external.{name}={getattr(self.settings, name)}"

    def _failed(self, told: str) -> Failed:
        now = ", ".join(f"{name}={value[:_LONG]}" for name, value in self._told.items())
        return Failed(f"{self.where}: {told}, with {now}")

    @property
    def _told(self) -> dict[str, str]:
        """The parameters as a command gets them."""
        return {name: ",".join(map(_digits, value.ravel())) for name, value in self.values.items()}

    def _checked(self, picture: np.ndarray) -> np.ndarray:
        if picture.dtype.kind != "f":
            raise Failed(f"{self.where} gives {picture.dtype}: linear pixels as floats are wanted")
        found = picture.astype(np.float32)
        (width, height) = self.sizes[0]
        if found.shape != (height, width, 3):
            raise Failed(
                f"{self.where} gives {found.shape}, not {(height, width, 3)}, rows, columns and "
                "channels: scene.external.width and .height say how large pictures are"
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
                return np.asarray(function(values, seed, view))
            except (Exception, SystemExit) as error:
                *_, last = traceback.extract_tb(error.__traceback__)
                raise self._failed(f"raises {error!r} ({last.filename}:{last.lineno})") from error

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
        # What a program leaves running may write there still.
        with tempfile.TemporaryDirectory(
            prefix="isas-external-", ignore_cleanup_errors=True
        ) as folder:
            out, *said = (Path(folder) / name for name in ("out.exr", "errors", "output"))
            told = self._told | dict(zip(_OWN, map(str, (out, seed, view, width, height))))
            words = [self._filled(word, told) for word in shlex.split(self.settings.command)]
            status = self._ended(words, *said)
            if status:
                raise self._failed(f"ends with {status}: {_last(said)}")
            if not out.is_file() or out.open("rb").read(len(_EXR)) != _EXR:
                raise self._failed(f"writes no EXR as {{out}}: {_last(said)}")
            try:
                picture = images.load(out, finite=False)
            except InputError as error:
                raise self._failed(str(error).replace(str(out), "{out}")) from error
            if self._unasked:
                self._unasked = False
                found = images.unheeded([out], [picture.doubt])
                lines = [line.replace(str(out), "{out}") for line in found]
                self.warnings += [f"{self.where}: {line}" for line in lines]
            return picture.image

    def _ended(self, words: list[str], errors: Path, output: Path) -> int:
        """The exit status of a program, which writes into files: what it leaves running would hold
        pipes open."""
        with errors.open("wb") as to_errors, output.open("wb") as to_output:
            streams = {"stdin": subprocess.DEVNULL, "stdout": to_output, "stderr": to_errors}
            try:
                # Of its own: Ctrl-C is for isas, which ends it and what it has started.
                process = subprocess.Popen(words, start_new_session=True, **streams)
            except OSError as error:
                raise self._failed(f"{words[0]}: {error.strerror}") from error
            try:
                return process.wait()
            finally:
                if process.returncode is None:
                    with contextlib.suppress(OSError):
                        os.killpg(process.pid, signal.SIGKILL)
                    process.wait()

    def _filled(self, word: str, told: dict[str, str]) -> str:
        def value(found: re.Match) -> str:
            if found[1] not in told:
                valid = ", ".join(f"{{{name}}}" for name in told)
                raise InputError(f"{self.where}: {found[0]}: valid in it: {valid}")
            return told[found[1]]

        return re.sub(r"\{([^{}]*)\}", value, word)


def _given(value) -> np.ndarray:
    """As it is given, whole numbers too, where these fit into 64 bits."""
    found = np.array(value)
    return found if found.dtype.kind in "iuf" else found.astype(float)


def _digits(number: np.number) -> str:
    """Without an exponent: programs take -3e-05 for an option."""
    if isinstance(number, np.integer):
        return str(number)
    return np.format_float_positional(number, trim="0")


def _last(said: list[Path]) -> str:
    """The last line of the first file that has one."""
    texts = [file.read_text(errors="replace").strip() for file in said]
    lines = [text.splitlines()[-1] for text in texts if text]
    return lines[0] if lines else "nothing on standard error or output"


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
