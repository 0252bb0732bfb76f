"""Starting Mitsuba: variant, LLVM library, threads.

Every module may `import mitsuba` at its top, and be imported before start(), in any order:

- Dr.Jit loads its LLVM library when it is first imported, once per process. Whoever does that
  after isas_cli was imported, ``llvm.prepare`` finds the library for it.
- Mitsuba's types exist only once there is a variant. Annotations do not need them, functions run
  later, and modules whose classes derive from one are plugins (``plugin``), which start() imports.

What a command imports before it has checked its settings does without Mitsuba all the same, whose
import takes a second.
"""

from __future__ import annotations

import functools
import glob
import importlib
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from . import llvm, memory
from .errors import InputError, nearest

SUFFIX = "_ad_rgb"

# cuInit in a process of its own: a broken driver may crash or hang, and CUDA does not survive
# a later fork. Mitsuba traces rays with OptiX, which some containers lack although CUDA works.
_CUDA_PROBE = """
import ctypes, os
cuda = ctypes.CDLL(os.environ.get("DRJIT_LIBCUDA_PATH") or "libcuda.so.1")
count, device = ctypes.c_int(), ctypes.c_int()
name = ctypes.create_string_buffer(256)
assert cuda.cuInit(0) == 0, "cuInit failed"
assert cuda.cuDeviceGetCount(ctypes.byref(count)) == 0 and count.value > 0, "no CUDA device"
assert cuda.cuDeviceGet(ctypes.byref(device), 0) == 0, "cuDeviceGet failed"
assert cuda.cuDeviceGetName(name, len(name), device) == 0, "cuDeviceGetName failed"
ctypes.CDLL(os.environ.get("DRJIT_LIBOPTIX_PATH") or "libnvoptix.so.1")
print(name.value.decode(errors="replace"))
"""


_EARLIER = "loaded before isas_cli was imported"
_NO_GPU = "no NVIDIA GPU found"
_NOT_TAKEN = (
    "Dr.Jit does not take it: it needs compute capability 7.5 or more, a current driver, and "
    "libcuda.so, which DRJIT_LIBCUDA_PATH may name"
)


@dataclass(frozen=True)
class Backend:
    """What a process runs on: LLVM's path and version are None for a CUDA variant, and the path of
    one that a program had loaded before. ``left_out``: why "auto" does not take the GPU that there
    is."""

    variant: str
    llvm_path: Path | None
    llvm_version: str | None
    threads: int
    device: str
    left_out: str = ""


def start(variant: str = "auto", threads: int = 0) -> Backend:
    """Import Mitsuba with `variant` and `threads` CPU threads (0 leaves Dr.Jit's
    choice, one for each core).

    `variant`: "auto" takes cuda_ad_rgb where a GPU works, else llvm_ad_rgb. May be called
    again in one process, also for another variant.
    Errors: InputError for a negative number of threads, a variant that does not exist, cannot
    differentiate or cannot run here, a machine without LLVM 16 or newer, and Dr.Jit imported
    before isas_cli, with an older one.
    """
    if threads < 0:
        raise InputError(f"threads={threads} is negative: give 0 (one for each core) or more")
    gpu, why_not = _find_gpu() if variant == "auto" or variant.startswith("cuda") else (None, "")
    if gpu and (unfit := _unfit()):
        gpu, why_not = None, f"{gpu}: {unfit}"
    if variant == f"cuda{SUFFIX}" and not gpu:
        raise InputError(
            f"variant={variant} cannot run here ({why_not}): use variant=llvm{SUFFIX} or auto"
        )
    library = None if gpu else _load_llvm()
    import drjit as dr
    import mitsuba as mi

    _check_name(variant, mi.variants())
    left_out = why_not if variant == "auto" and why_not != _NO_GPU else ""
    if variant == "auto":
        variant = ("cuda" if gpu else "llvm") + SUFFIX
    if library and not dr.has_backend(dr.JitBackend.LLVM):
        where = f"LLVM at {library.path}"
        raise InputError(f"variant={variant}: Dr.Jit cannot use {where} (its message is above)")
    mi.set_variant(variant)
    _import_plugins()
    every = _every_thread()
    if dr.thread_count() != (threads or every):
        dr.set_thread_count(threads or every)
    _device[:] = [gpu or _cpu_name()]
    return Backend(
        variant=variant,
        llvm_path=library.path if library else None,
        llvm_version=library.version if library else None,
        threads=dr.thread_count(),
        device=_device[0],
        left_out=left_out,
    )


_plugins: dict[str, str | None] = {}  # modules, and the variant that each was imported for
_device: list[str] = []
_theirs: list = []  # a program's file resolver, while a scene has its own


def device() -> str:
    """What kernels run on, by its own name; empty before ``start``."""
    return _device[0] if _device else ""


def plugin(module: str) -> None:
    """Have a module imported as soon as there is a variant: it adds to Mitsuba a plugin of isas's
    own, whose class derives from one of Mitsuba's."""
    import mitsuba as mi

    _plugins.setdefault(module)
    if mi.variant() is not None:
        _import_plugins()


def _import_plugins() -> None:
    """Those that the present variant does not have yet. Classes derive from one variant's: for
    another they are made anew, as Mitsuba does with its own."""
    import mitsuba as mi

    for name, earlier in list(_plugins.items()):
        if earlier != mi.variant():
            module = importlib.import_module(name)
            if earlier is not None:
                importlib.reload(module)
            _plugins[name] = mi.variant()


def look_beside(*folders: Path) -> None:
    """Files of the scene that is loaded next are looked for in ``folders`` as well, the last one
    first, and no longer where earlier scenes had theirs."""
    import mitsuba as mi

    if not _theirs:
        _theirs.append(mi.file_resolver())
    own = mi.FileResolver(_theirs[0])
    for folder in folders:
        own.prepend(str(folder))
    mi.set_file_resolver(own)


@contextmanager
def lent() -> Iterator[None]:
    """After the context a program has its variant, if it had set one, its threads and places of
    files again, if it had Mitsuba imported before; else all threads, and no scene's places."""
    before: tuple[str | None, int] = None, 0
    if "mitsuba" in sys.modules:
        import drjit as dr
        import mitsuba as mi

        before = mi.variant(), dr.thread_count()
    try:
        yield
    finally:
        if "mitsuba" in sys.modules:
            import drjit as dr
            import mitsuba as mi

            variant, threads = before
            if variant not in (None, mi.variant()):
                mi.set_variant(variant)
            dr.set_thread_count(threads or _every_thread())
            if _theirs:
                mi.set_file_resolver(_theirs.pop())


@functools.cache
def _every_thread() -> int:
    """As many as Dr.Jit takes by itself, before anything is set."""
    import drjit as dr

    return dr.thread_count()


@contextmanager
def loading() -> Iterator[None]:
    """Within the context at least two threads work.

    Mitsuba hands the reading of an EXR file to the thread pool and waits: the only thread of a
    pool of one would wait for itself.
    """
    import drjit as dr

    wanted = dr.thread_count()
    if wanted < 2:
        dr.set_thread_count(2)
    try:
        yield
    finally:
        if wanted < 2:
            dr.set_thread_count(wanted)


def release() -> None:
    """Wait, and give back the memory that Dr.Jit keeps of arrays that are gone: between phases that
    need arrays of other sizes it would only add up."""
    import drjit as dr

    sync()
    dr.flush_malloc_cache()


def sync() -> None:
    """Wait until all work queued so far is done; call it before a clock is read."""
    import drjit as dr

    dr.sync_thread()


def _find_gpu() -> tuple[str | None, str]:
    """(name of the first GPU, ""), or (None, why no GPU can be used)."""
    if not glob.glob("/dev/nvidia[0-9]*") and not Path("/dev/dxg").exists():
        return None, _NO_GPU
    command = [sys.executable, "-I", "-S", "-c", _CUDA_PROBE]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    except subprocess.TimeoutExpired:
        return None, "the NVIDIA driver does not answer"
    if done.returncode != 0:
        reason = done.stderr.strip().splitlines()[-1:] or ["the NVIDIA driver crashed"]
        shown = os.environ.get("CUDA_VISIBLE_DEVICES")
        hidden = "" if shown is None else f"; CUDA_VISIBLE_DEVICES='{shown}' may hide all cards"
        return None, reason[0].split(": ", 1)[-1] + hidden
    return done.stdout.strip(), ""


def _unfit() -> str:
    """Why Dr.Jit or Mitsuba cannot use the GPU that was found; empty where both can. Sets a CUDA
    variant. Raises InputError where its memory is full."""
    import drjit as dr
    import mitsuba as mi

    if not dr.has_backend(dr.JitBackend.CUDA):
        return _NOT_TAKEN
    mi.set_variant(f"cuda{SUFFIX}")
    try:
        # OptiX starts with the first scene that has a shape.
        with loading():
            mi.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    except RuntimeError as error:
        if memory.exhausted(error):
            raise InputError(
                "the GPU's memory is full: wait for what else runs on it, choose another by "
                f"CUDA_VISIBLE_DEVICES, or give variant=llvm{SUFFIX}"
            ) from error
        return f"OptiX does not work on it ({' '.join(str(error).split())})"
    return ""


def _load_llvm() -> llvm.Library:
    """Find LLVM and tell Dr.Jit, which reads the variable when it is imported. What it has loaded
    by then stays, if it is new enough."""
    loaded = None
    if "drjit" in sys.modules:
        import drjit as dr

        loaded = dr.detail.llvm_version()
        version = ".".join(map(str, loaded))
    try:
        library = llvm.find()
    except InputError:
        if loaded is None or loaded[0] < llvm.OLDEST:
            raise
        return llvm.Library(None, version, _EARLIER)
    if loaded is not None:
        # Of one that Dr.Jit was told of and could not load it has said so.
        failed = loaded[0] < 0 and os.environ.get(llvm.VARIABLE) == str(library.path)
        if loaded[0] < llvm.OLDEST and not failed:
            raise InputError(
                f"drjit was imported before isas_cli, without LLVM {llvm.OLDEST} or newer: import "
                f"isas_cli before drjit and mitsuba, or set {llvm.VARIABLE}={library.path} in the "
                "environment"
            )
        if version != library.version and not failed:
            return llvm.Library(None, version, _EARLIER)
    os.environ[llvm.VARIABLE] = str(library.path)
    return library


def _check_name(variant: str, existing: list[str]) -> None:
    """Refuse what does not exist, and what is not differentiable RGB."""
    valid = ["auto"] + [name for name in existing if name.endswith(SUFFIX)]
    if variant in valid:
        return
    if variant in existing:
        raise InputError(f"variant={variant} needs to end in '{SUFFIX}': valid: {', '.join(valid)}")
    raise InputError(f"variant={variant} does not exist: {nearest(variant, valid)}")


def _cpu_name() -> str:
    """The processor's name as the system gives it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
