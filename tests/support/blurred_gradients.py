"""Gradients of blurred objectives by quadrature over the parameters, and what they are held to."""

from __future__ import annotations

import numpy as np
import references
from poses_for_tests import AT, SIGMA
from scenes_for_tests import means
from scipy import stats

from isas_cli import losses
from isas_cli.estimators.plateau import Plateau
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.rendering.renderer import Renderer

BATCH = 192  # four paths a pixel
LEVEL = 1e-4  # of each comparison of two unknowns
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(3)  # exact for the colour, whose ℒ is quadratic
STEPS = np.linspace(-4.5, 4.5, 61)  # of the place, in widths
STEP = 0.01  # of the differences of what is smoothed, in widths
SETS, PATHS = 8, 64  # of references; a pixel, node and side


def uniform(p) -> PixelDistribution:
    return PixelDistribution.uniform(Tiles.over(p.views))


def weights_at(shift: float) -> np.ndarray:
    """Of all nodes, (61, 3), in the blur about a place ``shift`` widths farther."""
    density = stats.norm.pdf(STEPS - shift) * (STEPS[1] - STEPS[0])
    return density[:, None] * (WEIGHTS / WEIGHTS.sum())[None, :]


def references_of(p) -> dict[str, np.ndarray]:
    """Gradients of both smoothed objectives, (sets, 2), by quadrature over the parameters; each set
    from two independent renderings of all nodes. By the place: central differences of the smoothed
    objective's values; by the colour: the slope of the quadratic through its nodes. Kept where they
    are known (``references``)."""
    of = [p.targets, AT, SIGMA, STEPS, NODES, STEP, SETS, PATHS]
    found = references.known("blurred", of, lambda: np.array(list(_by_quadrature(p).values())))
    return dict(zip(("image", "loss"), found))


def _by_quadrature(p) -> dict[str, np.ndarray]:
    renderer = Renderer(p)
    keys = p.unknowns.keys
    weight = weights_at(0)
    sides = [weights_at(side * STEP) for side in (1, -1)]
    slope = weight * NODES[None, :] / SIGMA[1]
    target = np.array(p.targets).reshape(-1, 3)

    def images(seed: int) -> np.ndarray:
        """P at all nodes, (61, 3, pixels, 3), by the same random numbers."""
        found = np.empty((len(STEPS), len(NODES), p.views.total, 3))
        for i, j in np.ndindex(found.shape[:2]):
            at = (AT[0] + SIGMA[0] * STEPS[i], AT[1] + SIGMA[1] * NODES[j])
            arrays = {key: np.array([x], np.float32) for key, x in zip(keys, at)}
            p.unknowns.write(p.unknowns.values_of(arrays))
            found[i, j] = means(p, PATHS, seed, renderer)
        return found

    def mean(weights, values):
        return np.tensordot(weights, values, axes=([0, 1], [0, 1]))

    found: dict[str, list] = {"image": [], "loss": []}
    for number in range(SETS):
        a, b = (images(1000 + 2 * number + side) for side in (0, 1))

        def of_image(weights) -> float:
            return float(np.mean((mean(weights, a) - target) * (mean(weights, b) - target)))

        squares = np.mean((a - target) * (b - target), axis=(2, 3))

        def of_loss(weights) -> float:
            return float(np.sum(weights * squares))

        residual = 2 * (mean(weight, a) - target)
        by_colour = {"image": np.mean(residual * mean(slope, b)), "loss": np.sum(slope * squares)}
        for kind, of in (("image", of_image), ("loss", of_loss)):
            difference = of(sides[0]) - of(sides[1])
            found[kind].append([difference / (2 * STEP * SIGMA[0]), by_colour[kind]])
    p.unknowns.write(p.unknowns.starts())
    return {kind: np.array(rows) for kind, rows in found.items()}


def rows(estimator, p, count: int, distribution=None) -> np.ndarray:
    """``count`` independent estimates of the gradient by both unknowns."""
    distribution = distribution or uniform(p)
    values = p.unknowns.starts()
    found = []
    for i in range(count):
        gradient = estimator.estimate(values, distribution, 7, i, 0.0)
        found.append([float(gradient[key][0]) for key in p.unknowns.keys])
    p.unknowns.write(values)
    return np.array(found)


def p_value(found: np.ndarray, reference: np.ndarray) -> float:
    """Welch's, of both unknowns, by Bonferroni; prints what is compared."""
    test = stats.ttest_ind(found, reference, equal_var=False)
    print("found", found.mean(axis=0), "reference", reference.mean(axis=0), "p", test.pvalue)
    return min(1.0, 2 * test.pvalue.min())


# Standard errors of a bias that is seen nine times in ten: beyond LEVEL's quantile, halved for two
# unknowns, one of 0.9 more.
POWER = stats.norm.isf(LEVEL / 4) + stats.norm.ppf(0.9)


def unbiased(found: np.ndarray, reference: np.ndarray, seen: float = 0.45) -> bool:
    """No bias seen, and one of the share ``seen`` of an unknown's own slope would have been nine
    times in ten, in both unknowns. Prints the least share."""
    errors = sum(side.var(axis=0, ddof=1) / len(side) for side in (found, reference))
    visible = POWER * np.sqrt(errors) / np.abs(reference.mean(axis=0))
    print("would see a bias of", visible)
    assert np.all(visible < seen), f"would not see a bias of {visible}"
    return p_value(found, reference) > LEVEL


def made(p, **settings) -> Plateau:
    return Plateau(p, losses.L2(), BATCH, **settings)
