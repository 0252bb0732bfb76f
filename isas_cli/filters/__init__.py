"""What neighbouring entries of an unknown may do for each other in Adam's step."""

from .bilateral import Bilateral
from .filter import Filter, Layout, OnUnknown, Step
from .gaussian import Gaussian
from .james_stein import JamesStein
from .laplacian import Laplacian
from .none import Nothing

__all__ = [
    "Bilateral",
    "Filter",
    "Gaussian",
    "JamesStein",
    "Laplacian",
    "Layout",
    "Nothing",
    "OnUnknown",
    "Step",
]
