"""Photographs with known cameras: read, checked, resampled, and made a scene of."""
