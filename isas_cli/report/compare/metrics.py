"""The four measures of PBDR, Eq. (7) to (9) and the text before them, for one run.

PBDR: Kakkar, Mukherjee, Ragothaman, Mehta, "Physics Based Differentiable Rendering for Inverse
Problems and Beyond", section IV, Evaluation Metrics. The paper leaves much open; each docstring
says what, and how it is filled in here.
"""

from __future__ import annotations

import math

import numpy as np

from ...records import Run
from .series import read

_CHANNELS = 3
_CONVERGED = 0.05


def reconstruction_error(run: Run) -> float:
    """RE = 1/N Σ_i ‖I_i^gt - I_i^r‖² (Eq. 7), N the pixels of all views, at the last evaluation.

    ``image_rmse`` is the root mean square over pixels *and* channels, and ‖·‖² adds the channels
    up: RE = 3 image_rmse². Linear radiance, squared. The paper does not say whether images are
    linear or display values; linear ones are what the optimisation compares. NaN where not known.
    """
    return _CHANNELS * last(run, "image_rmse") ** 2


def material_error(run: Run) -> float:
    """MPEA = 1/M Σ_j ‖P_j^gt - P_j^est‖² (Eq. 8) at the last evaluation: smaller is better, though
    the paper calls it an accuracy.

    M counts the unknowns (keys), and ‖·‖² is the *mean* over the entries of a key that some view
    sees, so that a texture does not outweigh a scalar by its resolution, which the paper leaves
    open: MPEA = parameter_rmse². In the unit of parameter_rmse, squared; NaN without a known truth.
    """
    return last(run, "parameter_rmse") ** 2


def convergence_speed(run: Run) -> float:
    """CS, "the number of iterations needed to reach convergence", without an equation in the paper.

    Here: the first evaluated iteration from which on image_rmse stays within 5 % of its whole drop
    (start minus final) around its final value. The image's error, because photographs have it too.
    +inf, not converged, where the error did not fall, or where only the last evaluation lies in
    that band: the run ended while the error was still moving. NaN where the error is not known.
    Runs of different length have different final values: a method that stops early or at a worse
    error "converges" sooner. What accuracy costs, accuracy_time.csv says; CS does not.
    """
    known = run.history[np.isfinite(run.history["image_rmse"])]
    error = known["image_rmse"].to_numpy()
    if len(error) < 2:
        return math.nan
    drop = error[0] - error[-1]
    outside = np.flatnonzero(np.abs(error - error[-1]) > _CONVERGED * drop)
    if drop <= 0 or outside[-1] >= len(error) - 2:
        return math.inf
    return float(known["iteration"].iloc[outside[-1] + 1])


def gradient_noise(run: Run) -> float:
    """GN = 1/N Σ_t ‖g_t^smoothed - g_t^unsmoothed‖² (Eq. 9), as a mean over evaluated iterations t.

    The column ``gradient_noise`` holds 1/N ‖…‖² of one iteration, N the gradient's entries that its
    batch touched and g^smoothed Adam's bias-corrected first moment. The paper neither defines N and
    the smoothing nor divides by T; the mean over t instead of the sum keeps runs of different
    length comparable. NaN where no iteration recorded it.
    """
    recorded = run.history["gradient_noise"].to_numpy(dtype=float)
    recorded = recorded[np.isfinite(recorded)]
    return float(recorded.mean()) if recorded.size else math.nan


def last(run: Run, measure: str) -> float:
    """The last known value of a measure."""
    known = run.history[measure].dropna()
    return float(known.iloc[-1]) if len(known) else math.nan


def share(run: Run, measure: str) -> float:
    """Final error divided by the start's; NaN where either is not known."""
    series = read(run, measure)
    return math.nan if series is None else last(run, measure) / float(series.error[0])
