"""Hard cases of volumes: see ``hard_cases``."""

from __future__ import annotations

import struct

import numpy as np
from hard_cases import Case, start

DENSITY, ALBEDO = "box.interior_medium.sigma_t.data", "box.interior_medium.albedo.data"
SCATTERS = (
    '<integrator type="volpath"><integer name="max_depth" value="16"/>'
    '<integer name="rr_depth" value="8"/></integrator>'
)
GLOWS = '<integrator type="emission"/>'
VOLUME = (
    '<volume type="gridvolume" name="{name}"><string name="filename" value="{name}.vol"/>'
    '<boolean name="raw" value="true"/><transform name="to_world"><scale value="2"/>'
    '<translate x="-1" y="-1" z="-1"/></transform></volume>'
)
BOX = (
    '<shape type="cube" id="box"><bsdf type="null"/><medium type="heterogeneous" name="interior">'
    f"{VOLUME.format(name='sigma_t')}{VOLUME.format(name='albedo')}</medium></shape>"
)
# A grid goes with fewer paths: it has many entries, and each is to end somewhere sound.
SHORT = ("budget.iterations=60", "target.spp=64", "estimator.batch=512")
SHORT += ("optimizer.schedule=exponential",)
# Of cases whose paths meet ten thousand times as many collisions.
FEW = ("budget.iterations=12", "target.spp=4", "estimator.batch=64", "evaluation.spp=2")


def vol(values: np.ndarray) -> bytes:
    """``values (Z, Y, X, channels)`` as a file of Mitsuba's."""
    z, y, x, channels = values.shape
    head = b"VOL" + struct.pack("<B5i6f", 3, 1, x, y, z, channels, 0, 0, 0, 1, 1, 1)
    return head + np.ascontiguousarray(values, "<f4").tobytes()


def _volume(
    name: str,
    provokes: str,
    within: float,
    density,
    begins: dict,
    albedo: float = 0.6,
    settings: tuple[str, ...] = (),
    **more,
) -> Case:
    """A box between -1 and 1. ``density (n, n, n)``; ``begins``: what is unknown."""
    density = np.asarray(density, np.float32)[..., None]
    grey = np.full((*density.shape[:3], 3), albedo)
    files = {"sigma_t.vol": vol(density), "albedo.vol": vol(grey)} | more.pop("files", {})
    return Case(
        *(name, provokes, begins, within),
        **{"shapes": BOX, "files": files, "integrator": SCATTERS} | more,
        settings=(*SHORT, "optimizer.lr=0.1", *settings),
    )


def _uneven(low: float = 0.5, high: float = 3.0) -> np.ndarray:
    return np.random.default_rng(3).uniform(low, high, (4, 4, 4))


def _spike(most: float, least: float = 1e-3) -> np.ndarray:
    """One point of ``most`` in what is as good as empty."""
    values = np.full((4, 4, 4), least)
    values[2, 1, 2] = most
    return values


FROM_ONE = start(DENSITY, 1.0)
TIGHT = ("sampler=ours", "sampler.refresh=30", "optimizer.lr=2", "budget.iterations=90")

CASES = [
    _volume("a cloud", "nothing: what the volumes are measured against", 1.0, _uneven(), FROM_ONE),
    _volume("clears up", "a density that is the least in truth", 0.2, _spike(1e-3), FROM_ONE),
    _volume(
        *("an empty start", "a density that begins at the least", 1.5),
        *(_uneven(), start(DENSITY, 1e-3)),
    ),
    _volume(
        *("a wall", "a density of 1e4 throughout, of which the surface alone is seen", 1.1e4),
        *(np.full((4, 4, 4), 1e4), FROM_ONE),
        settings=("optimizer.lr=100", "target.spp=16"),
    ),
    _volume(
        *("a spike in emptiness", "a majorant 1e7 times the densities that are looked for", 1.0),
        *(_spike(1e4), start(DENSITY, "{folder}/spike.vol")),
        files={"spike.vol": vol(_spike(1e4, 1.0)[..., None])},
        settings=FEW,
    ),
    _volume(
        *("a peak between looks", "a density that grows by 2 in a step, its majorant with it", 300),
        *(_spike(300.0, 0.1), FROM_ONE),
        settings=TIGHT,
    ),
    _volume(
        *("glows in emptiness", "no density at all at the start", 1.5),
        *(_uneven(), start(DENSITY, 0.0, range=[0, 100])),
        integrator=GLOWS,
    ),
    _volume(
        *("nothing glows", "no density at all in truth", 0.5),
        *(np.zeros((4, 4, 4)), start(DENSITY, 1.0, range=[0, 100])),
        integrator=GLOWS,
        warns="count as that",
    ),
    _volume(
        *("soot", "an albedo of 0 in truth", 0.3, _uneven(), start(ALBEDO, 0.5, range=[0, 1])),
        albedo=0.0,
        settings=("optimizer.lr=0.03",),
    ),
    _volume(
        *("snow", "an albedo of 1 in truth", 0.2, _uneven(), start(ALBEDO, 0.5, range=[0, 1])),
        albedo=1.0,
        settings=("optimizer.lr=0.03",),
    ),
    _volume(
        "in the fog",
        "a camera inside the medium, which Mitsuba knows only if the file says so",
        *(1.0, _uneven(), FROM_ONE),
        origin="0,0,0.5",
        warns="stands within the medium",
    ),
    _volume(
        *("a single point", "a grid of 1 × 1 × 1", 0.2, np.full((1, 1, 1), 0.5), FROM_ONE),
    ),
    _volume(
        *("levels", "a grid whose sides are odd, from coarse to fine", 1.0),
        *(np.random.default_rng(4).uniform(0.5, 3.0, (3, 5, 7)), start(DENSITY, 1.0, levels=3)),
    ),
]
