"""Repeated estimates of a loss gradient, as vectors that a test of means can take."""

from __future__ import annotations

from functools import lru_cache

import drjit as dr
import mitsuba as mi
import numpy as np
from omegaconf import DictConfig, OmegaConf

from isas_cli.config.compose import compose, instantiate, options
from isas_cli.config.schema import OptimizerConfig
from isas_cli.engine.optimiser import Stepper
from isas_cli.estimators.two_path import TwoPath
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime import streams
from isas_cli.samplers.sampler import Moments, OnImages, Sampler
from isas_cli.scene.problem import Problem
from isas_cli.unknowns.parameters import flat, unflat


@lru_cache(maxsize=None)
def _composed(group: str, name: str) -> DictConfig:
    return compose(["scene=pottery", f"{group}={name}"])[group]


def configured(group: str, name: str, settings: dict | None = None):
    """The sampler or loss that ``configs/`` offers by this name. ``settings``: key within the
    group → value. Raises InputError where the class does not take one."""
    node = _composed(group, name).copy()
    for key, value in (settings or {}).items():
        OmegaConf.update(node, key, value, force_add=True)
    return instantiate(node, group)


def shared_settings(name: str) -> tuple[str, frozenset[str]]:
    """Where the settings that samplers share are within this one's, as a prefix of their keys, and
    which of them it uses. A sampler around another leaves them to that."""
    made = configured("sampler", name)
    return ("base.", made.base.uses) if hasattr(made, "base") else ("", made.uses)


def looking(name: str) -> Sampler:
    """As configured, but for cells of two pixels' side and enough paths in them that the pmf
    follows the image and not the noise, where it looks at all."""
    prefix, uses = shared_settings(name)
    looks = {"stage1.resolution": 6, "stage1.spp": 4}
    taken = {prefix + k: v for k, v in looks.items() if k.rpartition(".")[2] in uses}
    return configured("sampler", name, taken)


def unbiased_losses() -> list[str]:
    """Names of the losses of single pixels that claim an unbiased gradient from single samples."""
    made = {name: configured("loss", name) for name in options("loss")}
    return [name for name, loss in made.items() if loss.linear and loss.windows is None]


class Gradients:
    """Gradient estimates of one problem and loss, one recorded estimator for all of them.

    ``values``: where the gradient is taken, at first the start values.
    """

    def __init__(self, problem: Problem, loss, batch: int, estimator: type = TwoPath):
        self.problem, self.loss, self.batch = problem, loss, batch
        self.values = problem.unknowns.starts()
        self._estimator = estimator(problem, loss, batch)
        self._moments: Moments | None = None

    def prepared(self, sampler: Sampler, freeze: bool = True) -> OnImages:
        return sampler.on(self.problem, self.loss, self.batch, freeze)

    def uniform(self, repeats: int, base: int) -> np.ndarray:
        """``repeats`` estimates from uniformly drawn pixels, ``(repeats, m)``."""
        distribution = PixelDistribution.uniform(Tiles.over(self.problem.views))
        return self.drawn_from(distribution, repeats, base)

    def sampled(self, sampler: OnImages, repeats: int, base: int, every: int = 4) -> np.ndarray:
        """``repeats`` estimates, ``(repeats, m)``, with a new look by ``sampler`` at
        every ``every``-th, averaged with earlier looks as in a run. Estimates of one look have the
        same mean whatever it found, so they are as uncorrelated as others."""
        moments = self.moments() if "moments" in sampler.settings.needs else None
        weights = None

        def distribution(i: int) -> PixelDistribution:
            nonlocal weights
            weights = sampler.blended(weights, sampler.look(self.values, base, i, moments))
            return sampler.distribution(weights)

        return self._repeated(distribution, repeats, base, every)

    def drawn_from(self, distribution: PixelDistribution, repeats: int, base: int) -> np.ndarray:
        """``repeats`` estimates from one distribution, ``(repeats, m)``."""
        return self._repeated(lambda i: distribution, repeats, base, repeats)

    def _repeated(self, distribution, repeats: int, base: int, every: int) -> np.ndarray:
        unknowns, rows = self.problem.unknowns, []
        for i in range(repeats):
            if i % every == 0:
                present = distribution(i)
            unknowns.attach(self.values)
            self._estimator.accumulate(present, base, i)
            gradients = unknowns.gradients()
            rows.append(np.concatenate([np.array(flat(gradients[k])) for k in unknowns.keys]))
        unknowns.write(self.values)  # detach: other tests' scenes live in the same process
        return np.array(rows, np.float64)

    def moments(self) -> Moments:
        """Adam's moments after some steps of uniform sampling, all with the gradient here."""
        if self._moments is None:
            stepper = Stepper(self.problem.unknowns, OptimizerConfig())
            for row in self.uniform(32, 98):
                gradients = {
                    key: unflat(self.values[key], mi.Float(row[entries].astype(np.float32)))
                    for key, entries in self.entries().items()
                }
                stepper.step(gradients, 0.0)
            self._moments = stepper.moments(0.5)
        return self._moments

    def entries(self) -> dict[str, slice]:
        """Where each unknown's entries are in a row of estimates."""
        result, end = {}, 0
        for unknown in self.problem.unknowns:
            size = dr.width(flat(self.values[unknown.key]))
            result[unknown.key] = slice(end, end + size)
            end += size
        return result

    def components(self, rows: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """``rows`` along unit directions, ``(K, m + textures)``: every entry, and the mean of all
        entries of an unknown, where a bias that all share stands out. In shares of the norm of
        the unknown's gradient, which ``reference (L, m)`` estimates."""
        columns = []
        for entries in self.entries().values():
            norm = np.linalg.norm(reference[:, entries].mean(axis=0))
            own = rows[:, entries] / norm
            columns.append(own)
            if own.shape[1] > 1:
                columns.append(own.sum(axis=1, keepdims=True) / np.sqrt(own.shape[1]))
        return np.concatenate(columns, axis=1)


def radiances(renderer: Renderer, values: dict, copies: int, seed: int) -> np.ndarray:
    """Radiances of single paths at ``values``, ``(3, copies, pixels)``: the same random numbers
    for the same seed."""
    p = renderer.problem
    p.unknowns.write(values)
    pixel = dr.tile(dr.arange(mi.UInt32, p.views.total), copies)
    colours = renderer.pixels(pixel, 1, lambda _: seed)
    return np.array(colours, np.float64).reshape(3, copies, -1)


def moved(problem: Problem, directions: dict, step: float) -> dict:
    """The start values plus ``step`` times ``directions`` (by key; others stay)."""
    starts = {u.key: u.start for u in problem.unknowns}
    return problem.unknowns.values_of(
        starts | {key: starts[key] + step * d for key, d in directions.items()}
    )


def difference_quotients(
    problem: Problem, losses: list, directions: dict, step: float, repeats: int
) -> np.ndarray:
    """Central differences of the losses from the start values, ``(losses, 2, repeats)``, along
    ``directions`` with ``step`` and half of it.

    Both ends see the same random numbers. Each repeat renders two independent images, of which
    ``measured`` makes an unbiased loss: the noise of the images does not add to it.
    """
    renderer = Renderer(problem)
    target = mi.Color3f(np.array(problem.targets).reshape(-1, 3).T)
    result = np.zeros((len(losses), 2, repeats))
    for i in range(repeats):
        seeds = [streams.seed(11, 2 * i + half, "evaluation") for half in (0, 1)]
        for s, h in enumerate((step, step / 2)):
            for sign in (-1, 1):
                values = moved(problem, directions, sign * h)
                a, b = (
                    mi.Color3f(radiances(renderer, values, 32, seed).mean(axis=1)) for seed in seeds
                )
                for l, loss in enumerate(losses):
                    value = np.array(loss.measured(a, b, target), np.float64).mean()
                    result[l, s, i] += sign * value / (2 * h)
    problem.unknowns.write(problem.unknowns.starts())
    return result


class WithoutWeights(TwoPath):
    """Broken on purpose: pretends that every pixel was drawn uniformly."""

    def accumulate(self, distribution, base, iteration):
        honest = PixelDistribution._probability
        alike = 1 / self.problem.views.total
        PixelDistribution._probability = lambda d, mass, pixels: dr.full(
            mi.Float, alike, dr.width(mass)
        )
        try:
            super().accumulate(distribution, base, iteration)
        finally:
            PixelDistribution._probability = honest
