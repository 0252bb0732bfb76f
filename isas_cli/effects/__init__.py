"""Which light transport a scene calls for, and the evidence."""

from .plan import Plan, decide
from .settings import Effects
from .structure import statements

__all__ = ["Effects", "Plan", "decide", "statements"]
