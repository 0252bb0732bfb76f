"""Pixel losses: value and derivative with respect to the rendered radiance.

Every loss is a weighted mean over the pixels of all views and their three channels,

    ℒ(I) = Σ_j w_j Σ_c ℓ(I_jc, T_jc) / (3 Σ_j w_j),

with w_j the target mask (1 where there is none). Of a loss of windows, ℓ is of the window around
pixel j, and counts as the least weight in it does. ``Loss.derivative`` returns ∂ℓ/∂I only; the
estimator multiplies by w_j / (3 Σ w). The image-space estimators feed a *single-sample* radiance
into it: that is unbiased for ∂ℒ/∂I exactly when ∂ℓ/∂I is linear in I (ISAS §4.1), which
``linear`` says.
"""

from .l1 import L1
from .l2 import L2
from .loss import Loss
from .relative_l2 import RelativeL2
from .structure import Structure

__all__ = ["L1", "L2", "Loss", "RelativeL2", "Structure"]
