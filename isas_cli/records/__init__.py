"""The files of one run: written whole, read back typed. Knows nothing of rendering.

A run's folder holds config.yaml, manifest.json, history.csv (one row per evaluation), summary.json,
frames/*.exr, checkpoint/state.npz and, from `report`, plots/*.png and report.html. Each file is
written under a temporary name in its own folder, flushed to the disk and renamed over the earlier
version, so that whoever reads at any moment, or after a kill, finds a whole file.
"""

from ..runtime.files import write_atomically
from .files import KEY_PREFIX, SCHEMA_VERSION, VALUE_PREFIX, key_of, safe_name, write_text
from .reader import Run, load, load_checkpoint
from .writer import RunWriter

__all__ = [
    "KEY_PREFIX",
    "SCHEMA_VERSION",
    "VALUE_PREFIX",
    "Run",
    "RunWriter",
    "key_of",
    "load",
    "load_checkpoint",
    "safe_name",
    "write_atomically",
    "write_text",
]
