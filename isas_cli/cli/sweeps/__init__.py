"""Sweeps: many runs of one command line, composed by Hydra."""
