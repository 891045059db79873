"""The highest rank in a box of states, by tables of the maxima over blocks of 2^i x 2^j cells."""

from __future__ import annotations

import math
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diffbot_lab.stability.paper.file import Certificate

Array = NDArray[np.float64]
TOO_HIGH = 32_767
"""rank of what is not ranked, and of what lies beyond the cells"""
_SLACK = 1e-11


class RankLookup:
    """Maxima of a certificate's ranks."""

    def __init__(self, certificate: Certificate) -> None:
        """Take the ranks; tables are made when they are needed."""
        ranks = certificate.ranks.astype(np.int16)
        ranks[ranks < 0] = TOO_HIGH
        self._rows, self._columns = ranks.shape
        self._tables: dict[tuple[int, int], NDArray[np.int16]] = {(0, 0): np.concatenate([ranks, ranks], axis=1)}
        self._lock = Lock()
        self._rho = certificate.rho
        around = [certificate.alpha[:-1] + 2.0 * math.pi * turn for turn in range(-4, 5)]
        self._alpha = np.concatenate(around)

    def _table(self, i: int, j: int) -> NDArray[np.int16]:
        """Maxima over 2^i x 2^j cells, the given one and those after it."""
        with self._lock:
            for one in range(1, i + 1):
                if (one, 0) not in self._tables:
                    self._tables[one, 0] = _wider(self._tables[one - 1, 0], 2 ** (one - 1), 0)
            for one in range(1, j + 1):
                if (i, one) not in self._tables:
                    self._tables[i, one] = _wider(self._tables[i, one - 1], 2 ** (one - 1), 1)
            return self._tables[i, j]

    def highest(self, rho: tuple[Array, Array], alpha: tuple[Array, Array]) -> NDArray[np.int16]:
        """Return the highest rank in each box; a cell that is only touched counts.

        Args:
            rho: bounds [m]; what is nearer than the first edge has rank 0, what is beyond the last TOO_HIGH.
            alpha: bounds [rad] within +-8 pi, or any that are at least a turn apart.
        """
        first = np.searchsorted(self._rho, rho[0], side="right") - 1
        last = np.searchsorted(self._rho, rho[1], side="right") - 1
        left = np.searchsorted(self._alpha, alpha[0] - _SLACK, side="right") - 1
        right = np.searchsorted(self._alpha, alpha[1] + _SLACK, side="right") - 1
        around = (right - left >= self._columns - 1) | (alpha[1] - alpha[0] > 6.0)
        width = np.where(around, self._columns, np.maximum(right - left + 1, 1))
        left = np.where(around, 0, left % self._columns)
        first = np.maximum(first, 0)
        height = np.minimum(last, self._rows - 1) - first + 1
        found = np.zeros(len(first), np.int16)
        some = np.flatnonzero(height > 0)
        found[some] = self._maxima(first[some], height[some], left[some], width[some])
        # NaN is sorted to the end, and counts as beyond.
        found[~(last < self._rows)] = TOO_HIGH
        return found

    def _maxima(self, first: Any, height: Any, left: Any, width: Any) -> NDArray[np.int16]:
        """Maxima over blocks, each by four overlapping ones of 2^i x 2^j cells."""
        i, j = np.frexp(height)[1] - 1, np.frexp(width)[1] - 1
        found = np.zeros(len(first), np.int16)
        for kind in np.unique(64 * i + j):
            at = np.flatnonzero(64 * i + j == kind)
            p, q = divmod(int(kind), 64)
            table = self._table(p, q)
            rows = first[at], first[at] + height[at] - 2**p
            columns = left[at], left[at] + width[at] - 2**q
            found[at] = np.maximum.reduce([table[row, column] for row in rows for column in columns])
        return found


def _wider(table: NDArray[np.int16], shift: int, axis: int) -> NDArray[np.int16]:
    """Return the maxima over twice as many cells along an axis; the last ones, which have no partner, are not asked."""
    result = table.copy()
    if axis == 0:
        result[:-shift] = np.maximum(table[:-shift], table[shift:])
    else:
        result[:, :-shift] = np.maximum(table[:, :-shift], table[:, shift:])
    return result
