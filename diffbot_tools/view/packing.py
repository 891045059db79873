"""Columns of numbers in a page: integers of a fine unit, their differences, compressed, as base64.

Neighbouring values differ little, so that a difference needs one or two bytes where a float64 has eight.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

UNIT = 1e-5
"""[m], [rad], [m/s] ... of the integers: finer than any sensor; coarser only for values that would not fit"""
TIME_UNIT = 1e-4
"""[s] of times"""
MISSING = -(2**31)
"""stands for NaN and infinite values"""
_LARGEST = 2.0**30


class Packer:
    """Collects columns; :meth:`text` is what the page unpacks (page/packing.js)."""

    def __init__(self) -> None:
        """Start empty."""
        self._parts: list[bytes] = []
        self._size = 0

    def table(self, columns: Mapping[str, Array]) -> dict[str, Any]:
        """Add a table of columns (n,) of equal length; return its description for the page."""
        rows = len(next(iter(columns.values()))) if columns else 0
        described = {}
        for name, values in columns.items():
            unit, data = pack(values, TIME_UNIT if name == "t" else UNIT)
            described[name] = {"unit": unit, "at": self._size}
            self._parts.append(data)
            self._size += len(data)
        return {"rows": rows, "columns": described}

    def text(self) -> str:
        """Return all columns, compressed (zlib) and as base64."""
        return base64.b64encode(zlib.compress(b"".join(self._parts), 6)).decode("ascii")


def pack(values: Array, unit: float) -> tuple[float, bytes]:
    """Return the unit of the integers and the bytes of their differences, the lowest bytes of all first."""
    finite = np.isfinite(values)
    largest = float(np.abs(values[finite]).max()) if finite.any() else 0.0
    unit = max(unit, largest / _LARGEST)
    whole = np.full(len(values), MISSING, np.int64)
    whole[finite] = np.round(values[finite] / unit).astype(np.int64)
    # Modulo 2^32, as the page adds them up again.
    differences = np.diff(whole, prepend=0).astype(np.uint32)
    return unit, differences.astype("<u4").view(np.uint8).reshape(-1, 4).T.tobytes()
