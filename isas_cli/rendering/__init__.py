"""Radiance and derivatives of chosen pixels, behind one adapter for all integrators."""
