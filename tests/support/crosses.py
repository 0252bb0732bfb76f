"""Crosses of many things with many others, thinned to what `make test` has the time for."""

from __future__ import annotations

from collections.abc import Sequence

import pytest


def crossed(rows: Sequence, columns: Sequence, each: int, always: Sequence = ()) -> list:
    """All pairs as parameters of a test. ``each`` of the columns of every row are for every run,
    spread so that all columns have their share of rows, and ``always`` those that are named; the
    others are marked slow (`make test-all`)."""
    found = []
    for number, row in enumerate(rows):
        chosen = {(number * each + k) % len(columns) for k in range(each)}
        for index, column in enumerate(columns):
            marks = () if index in chosen or column in always else pytest.mark.slow
            found.append(pytest.param(row, column, marks=marks, id=f"{row}-{column}"))
    return found


def some(names: Sequence[str], chosen: Sequence[str]) -> list:
    """All names as parameters of a test, those that are not ``chosen`` marked slow."""
    missing = set(chosen) - set(names)
    assert not missing, f"{missing} are none of {names}"
    return [n if n in chosen else pytest.param(n, marks=pytest.mark.slow) for n in names]
