"""What the benchmarks read from their processes: every row, whatever else is printed."""

import sys
from pathlib import Path
from types import SimpleNamespace

import _child
import _rows
import gpu
import pytest
import step_time

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


def test_what_is_measured_on_a_card_runs_there(monkeypatch):
    """In processes of their own auto might take LLVM."""
    commands, started = [], []

    def run(command, **settings):
        commands.append(command)
        return SimpleNamespace(stdout="0.1")

    monkeypatch.setattr(step_time, "subprocess", SimpleNamespace(run=run))
    gpu.steps(1)
    assert {command[-1] for command in commands} == {"variant=cuda_ad_rgb"} <= {*gpu.PLAIN}
    monkeypatch.setattr(_child.backend, "start", started.append)
    monkeypatch.setattr(_child, "isas", lambda *unused: lambda number: 0.0)
    _, _, side, batch, steps, *overrides = commands[0]
    _child.main(side, int(batch), int(steps), overrides)
    assert started == ["cuda_ad_rgb"]
