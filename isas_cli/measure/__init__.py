"""Measurements at a fixed place of parameter space: variances, landscapes."""
