"""Text files of numbers in columns; every error names file, line and value."""

from __future__ import annotations

import math
from collections.abc import Iterator
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import NamedTuple

from diffbot_core.errors import DiffbotError
from diffbot_core.units import NS_PER_S

_END_OF_TIME = 2**31 * NS_PER_S
"""[ns] bound of a stamp, whose seconds are sent as int32"""


class DataError(DiffbotError):
    """A line of a data file that cannot be used."""


class Row(NamedTuple):
    """The words of one line, and where it stands."""

    path: Path
    line: int
    words: list[str]

    def error(self, what: str) -> DataError:
        """Return the error that names file and line."""
        return DataError(f"{self.path}, line {self.line}: {what}")

    def stamp(self, index: int) -> int:
        """Return a time [s] as [ns], without the rounding of a float.

        Raises:
            DataError: if it is no number from 0 to 2^31 s.
        """
        word = self.words[index]
        try:
            nanoseconds = Decimal(word) * NS_PER_S
            if 0 <= nanoseconds < _END_OF_TIME:
                return round(nanoseconds)
        except InvalidOperation:  # also raised by a comparison with nan
            pass
        raise self.error(f"time {_shown(word)} must be a number of seconds from 0 to 2^31")

    def number(self, index: int, name: str, low: float, high: float) -> float:
        """Return a number in [low, high].

        Raises:
            DataError: if it is anything else.
        """
        word = self.words[index]
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise self.error(f"{name} {_shown(word)} must be a number from {low:g} to {high:g}")
        return value

    def whole(self, index: int, name: str) -> int:
        """Return an int32.

        Raises:
            DataError: if it is anything else.
        """
        word = self.words[index]
        try:
            value = int(word)
        except ValueError:
            value = 2**31
        if not -(2**31) <= value < 2**31:
            raise self.error(f"{name} {_shown(word)} must be a whole number of 32 bits")
        return value


def _shown(word: str) -> str:
    return repr(word if len(word) <= 40 else word[:40] + "...")


def rows(path: Path) -> Iterator[Row]:
    """Iterate over the lines of a file, without comments (``#``) and empty lines.

    Raises:
        DataError: if the file cannot be read.
    """
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            for number, line in enumerate(file, 1):
                words = line.partition("#")[0].split()
                if words:
                    yield Row(path, number, words)
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror}") from error


def table(path: Path, columns: int) -> Iterator[Row]:
    """Iterate over the lines of a file that has this number of columns throughout.

    Raises:
        DataError: if a line has another number, or the file cannot be read.
    """
    for row in rows(path):
        if len(row.words) != columns:
            raise row.error(f"{columns} columns expected, {len(row.words)} found: {_shown(' '.join(row.words))}")
        yield row
