"""`isas doctor`: what this machine has, and a tiny gradient that proves that it works.

Each check is a row of the table; one that fails says what to do, and the others still run.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Callable
from pathlib import Path

from .. import __version__
from ..runtime import backend, cache, llvm
from ..runtime.errors import InputError, IsasError, installing

PACKAGES = ("mitsuba", "drjit", "hydra-core", "OpenImageIO", "mitsuba-oidn")
GRADIENT_TOLERANCE = 1e-3  # float32 sums and differences; a wrong gradient is off by far more


def main(variant: str = "auto") -> int:
    """Print the table. Returns 0 when all that isas needs works, else 2 (see errors.py)."""
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False)
    table.add_column()
    table.add_column(overflow="fold")  # paths are for copying: wrapped, never cut
    problems: list[str] = []
    checks: list[Callable[[], list[tuple[str, str]]]] = [_versions, _memory, _kernel_cache, _cache]
    try:
        machine = backend.start(variant)
    except (InputError, ImportError) as error:
        problems.append(str(error))
    else:
        checks += [lambda: _machine(machine), _denoiser, _gradient]
    for check in checks:
        try:
            for name, value in check():
                table.add_row(name, value)
        except (IsasError, RuntimeError) as error:  # the latter is Mitsuba's or Dr.Jit's
            problems.append(" ".join(str(error).split()))
    console = Console(soft_wrap=True, highlight=False)
    console.print(table)
    for problem in problems:
        console.print(f"problem: {problem}", markup=False)
    if not problems:
        console.print("this machine can run isas")
    return InputError.status if problems else 0


def _versions() -> list[tuple[str, str]]:
    rows = [("isas", __version__), ("python", platform.python_version())]
    missing = []
    for name in PACKAGES:
        try:
            rows.append((name, importlib.metadata.version(name)))
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    if missing:
        raise InputError(f"Python packages are missing: {installing(' '.join(missing))}")
    return rows


def _machine(machine: backend.Backend) -> list[tuple[str, str]]:
    rows = [("variant", machine.variant), ("device", machine.device)]
    if machine.left_out:
        rows.append(("GPU", f"left out: {machine.left_out}"))
    if machine.llvm_path:
        library = llvm.find()
        rows.append(("LLVM", f"{library.version}, {library.origin}: {library.path}"))
    return [*rows, ("threads", str(machine.threads))]


def _memory() -> list[tuple[str, str]]:
    import psutil

    memory = psutil.virtual_memory()
    gib = 1024.0**3
    return [("memory", f"{memory.available / gib:.1f} of {memory.total / gib:.1f} GiB available")]


def _kernel_cache() -> list[tuple[str, str]]:
    """Where Dr.Jit keeps compiled kernels, and how much (DRJIT_CACHE_DIR moves it)."""
    folder = Path(os.environ.get("DRJIT_CACHE_DIR") or Path.home() / ".drjit")
    mib = sum(file.stat().st_size for file in folder.glob("*") if file.is_file()) / 1024.0**2
    return [("kernel cache", f"{folder}, {mib:.1f} MiB")]


def _cache() -> list[tuple[str, str]]:
    """Where rendered targets are kept (ISAS_CACHE_DIR, ISAS_CACHE_GIB)."""
    mib = 1024.0**2
    held = f"{cache.size() / mib:.1f} of at most {cache.limit() / mib:.0f} MiB, oldest go first"
    return [("target cache", f"{cache.folder()}, {held}")]


def _denoiser() -> list[tuple[str, str]]:
    """Denoise 32 x 32 pixels of noise around 1: the noise must shrink and the mean stay."""
    import mitsuba as mi
    import numpy as np

    noise = np.random.default_rng(1).uniform(0.5, 1.5, (32, 32, 3)).astype(np.float32)
    try:
        import mitsuba_oidn

        clean = np.array(mitsuba_oidn.denoise(mi.TensorXf(noise)))
    except (ImportError, RuntimeError) as error:
        advice = installing("mitsuba-oidn==0.1.2")
        raise InputError(f"the denoiser fails ({error}): {advice}") from error
    if not (abs(clean.mean() - noise.mean()) < 0.1 and clean.std() < 0.5 * noise.std()):
        advice = installing("mitsuba-oidn==0.1.2")
        raise InputError(f"the denoiser gives wrong results: {advice}")
    return [("denoiser", f"ok (noise {noise.std():.2f} before, {clean.std():.2f} after)")]


def _gradient() -> list[tuple[str, str]]:
    difference = gradient_difference()
    if not difference < GRADIENT_TOLERANCE:  # so written, NaN fails too
        raise InputError(
            f"the gradient of a test scene is wrong (relative difference {difference:.1e}): "
            f"{installing('mitsuba==3.9.1 drjit==1.5.0')}"
        )
    return [("gradient", f"gradient ok (relative difference {difference:.1e})")]


def gradient_difference(size: int = 4, step: float = 0.05) -> float:
    """|adjoint - finite difference| / |finite difference| for a textured diffuse plane.

    The derivative of the mean pixel value in a random direction of the texture's
    (size, size, 3) texels. The mean is linear in a plane's albedo, so central differences of
    any `step` are exact up to rounding, and with equal samples there is no noise either.
    Needs backend.start(). Host code: evaluates.
    """
    import drjit as dr
    import mitsuba as mi
    import numpy as np

    random = np.random.default_rng(1)
    albedo = random.uniform(0.3, 0.7, (size, size, 3)).astype(np.float32)
    direction = random.uniform(0.5, 1.0, albedo.shape).astype(np.float32)
    scene = mi.load_dict(_plane(mi.TensorXf(albedo)), optimize=False)
    key = "plane.bsdf.reflectance.data"
    params = mi.traverse(scene)
    integrator = scene.integrator()

    def mean_pixel(data: np.ndarray) -> float:
        params[key] = mi.TensorXf(data)
        params.update()
        return float(np.mean(np.array(mi.render(scene, seed=1)), dtype=np.float64))

    above = mean_pixel(albedo + step * direction)
    below = mean_pixel(albedo - step * direction)
    expected = (above - below) / (2.0 * step)

    params[key] = mi.TensorXf(albedo)
    dr.enable_grad(params[key])
    params.update()
    film_size = scene.sensors()[0].film().crop_size()
    shape = (int(film_size[1]), int(film_size[0]), 3)
    grad_in = dr.full(mi.TensorXf, 1.0 / np.prod(shape), shape)
    integrator.render_backward(scene, params, grad_in, seed=1)
    adjoint = float(np.sum(np.array(dr.grad(params[key]), dtype=np.float64) * direction))
    return abs(adjoint - expected) / abs(expected)


def _plane(albedo) -> dict:
    """A square that fills the view of one 16 x 16 camera, under a constant sky of radiance 1."""
    import mitsuba as mi

    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": {"type": "constant"},
        "plane": {
            "type": "rectangle",
            "bsdf": {
                "type": "diffuse",
                "reflectance": {"type": "bitmap", "data": albedo, "raw": True},
            },
        },
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 16},
        },
    }
