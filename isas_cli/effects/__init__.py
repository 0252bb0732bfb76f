"""Which light transport a scene calls for, and the evidence."""

from .structure import plan

__all__ = ["plan"]
