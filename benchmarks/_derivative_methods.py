"""Ways to the derivative of a picture by one of a scene's parameters.

A picture is told by two numbers: its mean (``mean``), and a sum whose weights rise over the picture
and differ between channels (``ramp``), by which lobes in the wrong place show. Every way gives an
estimate for one seed; many seeds give a mean and a standard error.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from _plugin_room import DEEP, DEPTH

from isas_cli.config import schema
from isas_cli.config.compose import compose, translate
from isas_cli.engine import assemble
from isas_cli.estimators.two_path import TwoPath
from isas_cli.losses import Loss
from isas_cli.rendering import integrators, rays
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime import backend
from isas_cli.runtime.errors import InputError
from isas_cli.scene import scene_file
from isas_cli.scene.problem import Problem
from isas_cli.scene.views import Views
from isas_cli.unknowns import registry
from isas_cli.unknowns.kind import Kind, Loaded
from isas_cli.unknowns.parameters import own

FUNCTIONALS = ("mean", "ramp")
_PATHS = 1 << 16  # of an estimate, about
_NEVER = 1000  # vertices after which Russian roulette begins: on no path


class _Linear(Loss):
    """A loss whose derivative by a pixel is the target: by it an estimator of a loss's gradient
    gives the derivative of a picture's weighted sum."""

    linear = True

    def derivative(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        return mi.Color3f(target)


class _Made(Exception):
    """Ends the making of a problem before its targets."""

    def __init__(self, problem: Problem):
        self.problem = problem


def problem(path: Path, starts: dict[str, object]) -> Problem:
    """As a run has it that begins with unknowns at ``starts``, before it renders targets. Raises
    InputError as the run does."""

    def made(found: Problem) -> None:
        raise _Made(found)

    unknowns = json.dumps({key: {"start": start} for key, start in starts.items()})
    composed = compose(
        translate(["scene=file", f"scene.path={path}", f"scene.unknowns={unknowns}"])
    )
    typed = schema.typed(composed)
    try:
        assemble.problem(typed.scene, typed.target, lambda done, total: None, check=made)
    except _Made as reached:
        return reached.problem
    raise AssertionError("a problem is checked before its targets are rendered")


@dataclass
class Trial:
    """A scene, and what may be unknown in it: ``kinds`` by key. ``refused``: what ``isas`` says of
    keys that it offers and then refuses."""

    scene: mi.Scene
    kinds: dict[str, Kind]
    media: bool
    params: mi.SceneParameters
    problem: Problem | None
    refused: dict[str, str] = field(default_factory=dict)

    @staticmethod
    def of(path: Path, prefix: str) -> "Trial":
        """Of a scene's file, with the keys that ``isas`` offers and that begin with ``prefix``."""
        with backend.loading():
            scene, _, _ = scene_file.load(str(path), None)
        loaded, kinds, refused = Loaded(mi.traverse(scene)), {}, {}
        for key, kind in registry.offered(loaded).items():
            if key.startswith(prefix):
                try:
                    kinds[key] = kind(key, loaded)
                except InputError as error:
                    refused[key] = str(error)
        starts = {key: _start(kind) for key, kind in kinds.items() if not kind.moves_geometry}
        made, said = _together(path, starts)
        if made is not None:
            # One scene for all ways: virtual calls reach the materials of every scene there is.
            scene, loaded = made.scene, Loaded(mi.traverse(made.scene))
            kinds = {key: type(kind)(key, loaded) for key, kind in kinds.items()}
        media = any(shape.interior_medium() is not None for shape in scene.shapes())
        return Trial(scene, kinds, media, mi.traverse(scene), made, refused | said)

    @cached_property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        return tuple(int(side) for side in self.scene.sensors()[0].film().crop_size())

    @property
    def samples(self) -> int:
        """Paths of a pixel."""
        return max(1, _PATHS // (self.size[0] * self.size[1]))

    @cached_property
    def weights(self) -> np.ndarray:
        """Of each of ``FUNCTIONALS``, ``(2, H, W, 3)``, each with the sum 1."""
        width, height = self.size
        across = np.linspace(0.2, 1.8, width) if width > 1 else np.ones(1)
        down = np.linspace(1.6, 0.4, height) if height > 1 else np.ones(1)
        ramp = down[:, None, None] * across[:, None] * np.array([1.5, 1.0, 0.5])
        both = np.stack([np.ones_like(ramp), ramp])
        return (both / both.sum((1, 2, 3), keepdims=True)).astype(np.float32)

    def integrator(self, kind: str) -> mi.Integrator:
        """Of Mitsuba's, with this scene's depth and no roulette."""
        depth = DEEP if self.media else DEPTH
        return mi.load_dict({"type": kind, "max_depth": depth, "rr_depth": _NEVER})

    # ----------------------------- values -----------------------------

    def put(self, values: dict[str, np.ndarray], attached: bool = False) -> dict:
        """Writes values by key into the scene; returns what derivatives are by."""
        leaves = {key: self.kinds[key].value(array) for key, array in values.items()}
        if attached:
            dr.enable_grad(leaves)
        for key, leaf in leaves.items():
            written: dict = {}
            self.kinds[key].write(leaf, written)
            for name, value in written.items():
                self.params[name] = value
        self.params.update()
        return leaves

    def picture(self, integrator: mi.Integrator, seed: int) -> np.ndarray:
        """The two numbers of a picture by one of Mitsuba's integrators, ``(2,)``."""
        with dr.suspend_grad():
            image = integrator.render(self.scene, 0, seed=seed, spp=self.samples)
        return self.told(np.array(image, np.float64).reshape(*self.weights.shape[1:]))

    def told(self, image: np.ndarray) -> np.ndarray:
        return np.sum(self.weights * image, (1, 2, 3))

    # ------------------------- ways, of one seed -------------------------

    def by_mitsuba(self, integrator: mi.Integrator, values: dict, seed: int) -> list[dict]:
        """Gradients by key, of each functional."""
        found = []
        for weights in self.weights:
            leaves = self.put(values, attached=True)
            gradient = mi.TensorXf(weights)
            with _unattached_is_zero():
                integrator.render_backward(
                    self.scene, leaves, gradient, 0, seed=seed, spp=self.samples
                )
            found.append({key: _array(dr.grad(leaf)) for key, leaf in leaves.items()})
            self.put(values)
        return found

    @cached_property
    def isas(self) -> tuple[TwoPath, ...]:
        """``isas``'s estimator, of each functional: short paths, unrolled."""
        return tuple(self._estimator(self.problem, weights) for weights in self.weights)

    @cached_property
    def replayed(self) -> tuple[TwoPath, ...] | None:
        """The same paths, replayed; None where there is one way only."""
        usual = self.problem.integrator
        if not usual.cuts:
            return None
        other = replace(self.problem, integrator=usual.deep(usual.paths))
        return tuple(self._estimator(other, weights) for weights in self.weights)

    def _estimator(self, problem: Problem, weights: np.ndarray) -> TwoPath:
        first = problem.only((0,)) if len(problem.film_sizes) > 1 else problem
        first = replace(
            first,
            targets=own(mi.Float, weights.reshape(-1)),
            share=dr.opaque(mi.Float, 1),
        )
        batch = self.samples * first.views.total // 2  # two paths for each
        return TwoPath(first, _Linear(), batch, freeze=False)

    def by_isas(self, estimators: tuple[TwoPath, ...], values: dict, seed: int) -> list[dict]:
        """Gradients by key, of each functional."""
        unknowns, found = self.problem.unknowns, []
        wanted = unknowns.values_of({k: v for k, v in values.items() if k in unknowns.keys})
        if not wanted:
            return [{}] * len(estimators)
        for estimator in estimators:
            uniform = PixelDistribution.uniform(Tiles.over(estimator.problem.views))
            gradients = estimator.estimate(wanted, uniform, seed, 1, 0.0)
            found.append({key: _array(gradients[key]) for key in wanted})
            unknowns.write(wanted)
        return found

    def pictured(self, seed: int) -> np.ndarray:
        """The two numbers of a picture by isas's own paths, ``(2,)``."""
        views = Views.of([self.size])
        pixel = dr.repeat(dr.arange(mi.UInt32, views.total), self.samples)
        sensors = dr.gather(mi.SensorPtr, self.scene.sensors_dr(), mi.UInt32(0))
        with dr.suspend_grad():
            stream = rays.stream(mi.UInt32(seed), dr.width(pixel))
            ray, weight = rays.spawn(sensors, views, *views.locate(pixel), stream)
            radiance, _ = self.problem.integrator.primal(self.scene, stream, ray)
            radiance = mi.Color3f(radiance * weight)
        each = np.array(radiance, np.float64).T.reshape(-1, self.samples, 3).mean(1)
        return self.told(each.reshape(*self.weights.shape[1:]))


def _start(kind: Kind) -> object:
    """A start that the configuration can say: few numbers, or one for all."""
    if 1 < kind.present.size <= 3:
        return [float(number) for number in kind.present.reshape(-1)]
    return float(np.mean(kind.present))


def _together(path: Path, starts: dict[str, object]) -> tuple[Problem | None, dict[str, str]]:
    """A problem of all keys that ``isas`` takes, and what it says of the others."""
    said: dict[str, str] = {}
    for names in (starts, *([name] for name in starts)):
        wanted = {name: starts[name] for name in names if name not in said}
        try:
            made = problem(path, wanted) if wanted else None
            if made is not None:
                TwoPath(made, _Linear(), 1, freeze=False)
        except InputError as error:
            if len(wanted) == 1:
                said[next(iter(wanted))] = str(error)
            continue
        if names is starts:
            return made, said
    left = {name: start for name, start in starts.items() if name not in said}
    return (problem(path, left) if left else None), said


@contextmanager
def _unattached_is_zero() -> Iterator[None]:
    """``prb`` raises an error where nothing that it met depends on what is unknown: its derivative
    is 0 then."""
    try:
        yield
    except RuntimeError as error:
        if not integrators.unattached(error):
            raise


def _array(gradient) -> np.ndarray:
    found = np.array(gradient, dtype=np.float64)
    return found if dr.is_tensor_v(gradient) else found.reshape(-1)
