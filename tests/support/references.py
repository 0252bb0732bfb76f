"""Numbers that tests compare estimates with and that cost far more than these: differences of
images of many paths, kept in references.json by what they are of.

What is of other arrays than when it was kept is another entry: not found, and computed. With
`ISAS_REFERENCES=live` (`make test-all`) all is computed, with `ISAS_REFERENCES=record` all that is
not there is kept as well.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from hashlib import blake2b
from pathlib import Path

import numpy as np

_KEPT = Path(__file__).with_name("references.json")
LIVE, RECORD = "live", "record"


def known(name: str, of: list, compute: Callable[[], np.ndarray]) -> np.ndarray:
    """What ``compute`` returns, kept or computed now. ``of``: arrays and numbers that it is of."""
    mode = os.environ.get("ISAS_REFERENCES", "")
    if mode == LIVE:
        return compute()
    key = f"{name} {digest(of)}"
    kept = json.loads(_KEPT.read_text()) if _KEPT.exists() else {}
    if key in kept:
        return np.array(kept[key])
    print(f"no reference kept: {key}")
    found = compute()
    if mode == RECORD:
        kept[key] = np.asarray(found, np.float64).tolist()
        lines = (f"{json.dumps(k)}: {json.dumps(v)}" for k, v in sorted(kept.items()))
        _KEPT.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    return found


def digest(of: list) -> str:
    """Of sums that the last bits of another processor do not change."""
    told = []
    for each in of:
        array = np.asarray(each, np.float64).ravel()
        weights = np.cos(np.arange(array.size))
        sums = array.sum(), np.abs(array).sum(), array @ weights
        told.append(f"{array.size} " + " ".join(f"{x:.3e}" for x in sums))
    return blake2b("; ".join(told).encode(), digest_size=8).hexdigest()
