"""Whether a look's density is to be trusted: a distance between images, and a warning."""

import mitsuba as mi
import numpy as np
import pytest
from crosses import some
from problems_for_tests import configured, workshops

from isas_cli.engine.workshop import Workshop
from isas_cli.samplers import reliability
from isas_cli.samplers.ours import Ours

SQUARES = ["ours", "preconditioned", "progress", "multiresolution"]
CELLS = 64 * 64


class Looks:
    """Stands for a sampler whose looks find ``image(rng)``, and weigh it as it is."""

    def __init__(self, image, floor: float = 0.0):
        self.image, self.settings = image, Ours(floor=floor)

    def measured(self, values, base, iteration):
        rng = np.random.default_rng((base, iteration))
        return [mi.Color3f(mi.Float(self.image(rng).astype(np.float32)))]

    def weighed(self, images):
        return images[0].x


def distance(image, floor: float = 0.0) -> float:
    return reliability.disagreement(Looks(image, floor), {}, 1, 0)


def test_looks_that_agree_are_no_distance_apart():
    image = np.random.default_rng(0).pareto(1.1, CELLS)
    assert distance(lambda rng: image) == pytest.approx(0, abs=1e-6)


def test_distance_of_a_look_that_finds_another_cell_each_time():
    """All mass in one random cell: of LOOKS looks, 1/LOOKS of the mass is where one has it."""

    def one_cell(rng):
        image = np.zeros(CELLS)
        image[rng.integers(CELLS)] = 1
        return image

    assert distance(one_cell) == pytest.approx(1 - 1 / reliability.LOOKS, abs=1e-6)
    assert distance(one_cell, 0.25) == pytest.approx(0.75 * distance(one_cell))


def test_distance_of_mild_noise():
    """Ones with exponential noise: E|X - 1|/2 = 1/e against the mean of infinitely many."""
    found = distance(lambda rng: rng.exponential(size=CELLS))
    assert found == pytest.approx(np.exp(-1), abs=0.02)


def test_measurements_that_are_not_finite_are_left_out():
    def broken(rng):
        image = np.ones(CELLS)
        image[7] = np.nan
        return image

    assert distance(broken) == pytest.approx(0, abs=1e-6)
    assert distance(lambda rng: np.zeros(CELLS)) == 0


SMALL = ["size=tiny", "target.spp=4", "budget.iterations=1", "evaluation.pixels=256"]
SMALL += ["evaluation.spp=2", "effects=full"]  # picked light samples find more


workshop = workshops(*SMALL)


def warning(workshop: Workshop, sampler: str) -> str | None:
    """What a run would say. That it does say it: ``a speck`` in support/hard_cases.py."""
    chosen = f"scene={workshop.problem.name}", f"sampler={sampler}"
    loop = workshop.loop(*configured(*chosen, *SMALL))
    values = loop.stepper.values
    said = reliability.warning(loop.sampler, values, loop.seed, 1 << 24)  # as a run does
    workshop.problem.unknowns.write(values)  # detach
    return said


CAUSTIC = pytest.mark.parametrize("workshop", ["caustic_failure"], indirect=True)


@CAUSTIC
@pytest.mark.parametrize("sampler", some(SQUARES, ("ours",)))
def test_a_caustic_that_paths_hardly_find_is_warned_of(workshop, sampler):
    said = warning(workshop, sampler)
    assert said is not None and said.startswith("the sampling density is not to be trusted")


@pytest.mark.slow  # every scene with some sampler: tests/scenes/test_tiny_scenes.py
@pytest.mark.parametrize("workshop", ["pottery", "jumpydumpy", "dodoco", "trashcan"], indirect=True)
def test_other_scenes_are_not(workshop):
    assert warning(workshop, "ours") is None


@CAUSTIC
@pytest.mark.parametrize("sampler", some(["uniform", "relevant", "gradient"], ("gradient",)))
def test_densities_without_squares_are_not(workshop, sampler):
    assert warning(workshop, sampler) is None
