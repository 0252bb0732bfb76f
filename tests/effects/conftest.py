"""Plans by as many batches everywhere, however fast the machine is."""

import math

import pytest

from isas_cli.effects import plan, probe


@pytest.fixture(autouse=True)
def as_many_batches(request, monkeypatch):
    """`BATCHES` of a module, or 64."""
    for name in ("_LEAST_BATCHES", "_MOST_BATCHES"):
        monkeypatch.setattr(probe, name, getattr(request.module, "BATCHES", 64))
    for name in ("_MOST", "_SHARE"):
        monkeypatch.setattr(plan, name, math.inf)
