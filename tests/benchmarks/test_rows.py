"""What the benchmarks read from their processes: every row, whatever else is printed."""

import sys
from pathlib import Path

import _rows
import pytest

# As Mitsuba prints a warning: what ends its colour stands before the next line.
CHILD = """
import sys
sys.path.insert(0, {folder!r})
import _rows
print("\\x1b[33m[scene.cpp] {{a: warning}}\\n\\x1b[0m", end="")
_rows.emit({{"side": "first", "seconds": 0.25}})
print("{{}} not a row")
_rows.emit({{"side": "second", "seconds": 0.5}})
"""


def test_a_row_after_a_coloured_warning_is_not_lost():
    child = CHILD.format(folder=str(Path(_rows.__file__).parent))
    found = _rows.collect([sys.executable, "-c", child])
    assert found == [
        {"side": "first", "seconds": 0.25},
        {"side": "second", "seconds": 0.5},
    ]


def test_a_failed_process_ends_the_benchmark():
    with pytest.raises(SystemExit) as stopped:
        _rows.collect([sys.executable, "-c", "raise SystemExit(3)"])
    assert stopped.value.code == 3
