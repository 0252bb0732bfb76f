"""The Hydra configs; a package so that they travel in the wheel."""
