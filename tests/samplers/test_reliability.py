"""Whether a look's density is to be trusted: a distance between images, and a warning."""

import json

import mitsuba as mi
import numpy as np
import pytest
from crosses import some

from isas_cli.config.compose import compose
from isas_cli.engine.experiment import run
from isas_cli.samplers import reliability

SQUARES = ["ours", "preconditioned", "progress", "multiresolution"]
CELLS = 64 * 64


class Looks:
    """Stands for a sampler whose looks find ``image(rng)``, and weigh it as it is."""

    def __init__(self, image, floor: float = 0.0):
        self.image, self.floor = image, floor

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


def warnings(folder, *settings: str) -> list[str]:
    common = ["size=tiny", "target.spp=4", "budget.iterations=1", "evaluation.count=1"]
    common += ["evaluation.pixels=256", "frames.views=0", "frames.snapshots=0"]
    common += ["effects=full"]  # picked light samples find more
    run(compose([*common, *settings]), folder)
    said = json.loads((folder / "summary.json").read_text())["warnings"]
    return [line for line in said if line.startswith("the sampling density is not to be trusted")]


@pytest.mark.parametrize("sampler", some(SQUARES, ("ours",)))
def test_a_caustic_that_paths_hardly_find_is_warned_of(sampler, tmp_path):
    assert len(warnings(tmp_path, "scene=caustic_failure", f"sampler={sampler}")) == 1


@pytest.mark.parametrize(
    "scene", some(["pottery", "jumpydumpy", "dodoco", "trashcan"], ("jumpydumpy",))
)
def test_other_scenes_are_not(scene, tmp_path):
    assert warnings(tmp_path, f"scene={scene}", "sampler=ours") == []


@pytest.mark.parametrize("sampler", some(["uniform", "relevant", "gradient"], ("gradient",)))
def test_densities_without_squares_are_not(sampler, tmp_path):
    assert warnings(tmp_path, "scene=caustic_failure", f"sampler={sampler}") == []
