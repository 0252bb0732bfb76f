"""Sweeps: many runs of one command line, through Hydra's sweepers and launchers."""
