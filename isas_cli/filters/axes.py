"""Linear maps along one axis of an array: tables that kernels can be recorded with."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..unknowns.parameters import own

# So many entries of a sum are written out; more make a loop.
_WRITTEN_OUT = 8


@dataclass
class Table:
    """A sparse matrix: of each of its rows the same number of columns that it is made of, and
    their weights, ``(rows * taps,)``, padded with weights of 0; ``row``: each one's number."""

    columns: mi.UInt32
    weights: mi.Float
    row: mi.UInt32

    @staticmethod
    def of(matrix: np.ndarray) -> Table:
        """``matrix``: dense, on the host. Evaluates."""
        rows, of_row = np.nonzero(matrix)
        place = np.arange(rows.size) - np.searchsorted(rows, rows)
        taps = int(place.max()) + 1
        columns = np.zeros((len(matrix), taps), np.uint32)
        weights = np.zeros((len(matrix), taps), np.float32)
        columns[rows, place], weights[rows, place] = of_row, matrix[rows, of_row]
        return Table(
            own(mi.UInt32, columns.ravel()),
            own(mi.Float, weights.ravel()),
            own(mi.UInt32, np.arange(len(matrix), dtype=np.uint32)),
        )


def interpolation(fine: int, coarse: int, wraps: bool) -> np.ndarray:
    """``(fine, coarse)``, rows of sum 1: entries are the middles of their cells, and beyond the
    outermost of them values stay, or the first follows the last."""
    place = (np.arange(fine) + 0.5) * coarse / fine - 0.5
    low = np.floor(place).astype(int)
    matrix = np.zeros((fine, coarse))
    for neighbour, weight in ((low, 1 - (place - low)), (low + 1, place - low)):
        at = neighbour % coarse if wraps else np.clip(neighbour, 0, coarse - 1)
        np.add.at(matrix, (np.arange(fine), at), weight)
    return matrix


def convolution(count: int, kernel: list[float], wraps: bool) -> np.ndarray:
    """``(count, count)``, symmetric for a symmetric ``kernel``, whose middle falls on the entry;
    reflected at open ends, around where the axis closes on itself."""
    matrix = np.zeros((count, count))
    radius = len(kernel) // 2
    for offset, weight in zip(range(-radius, radius + 1), kernel):
        at = np.arange(count) + offset
        around = at % count if wraps else np.minimum(at % (2 * count), (-at - 1) % (2 * count))
        np.add.at(matrix, (np.arange(count), around), weight)
    return matrix


def applied(entries: mi.Float, shape: tuple[int, ...], axis: int, table: Table) -> mi.Float:
    """A table applied along ``axis`` of ``entries``, which lie in this ``shape``. Traced."""
    stride, outer = math.prod(shape[axis + 1 :]), math.prod(shape[:axis])
    to = dr.width(table.row)
    taps = dr.width(table.columns) // to
    number = dr.arange(mi.UInt32, outer * to * stride)
    first = number // stride % to * taps
    begin = number // (stride * to) * (shape[axis] * stride) + number % stride

    def added(tap, total):
        source = begin + dr.gather(mi.UInt32, table.columns, first + tap) * stride
        weight = dr.gather(mi.Float, table.weights, first + tap)
        return tap + 1, dr.fma(weight, dr.gather(mi.Float, entries, source), total)

    state = mi.UInt32(0), dr.zeros(mi.Float, outer * to * stride)
    if taps <= _WRITTEN_OUT:
        for tap in range(taps):
            state = added(tap, state[1])
        return state[1]
    dr.eval(entries)
    return dr.while_loop(state, lambda tap, _: tap < taps, added, label="axis")[1]
