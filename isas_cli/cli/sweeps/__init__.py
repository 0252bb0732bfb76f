"""Sweeps: many runs, or races, of one command line, composed by Hydra."""
