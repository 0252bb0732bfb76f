"""Which light transport a scene calls for, and the evidence."""

from .plan import Plan, check, decide
from .settings import Effects
from .structure import statements

__all__ = ["Effects", "Plan", "check", "decide", "statements"]
