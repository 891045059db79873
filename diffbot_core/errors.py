"""Exceptions of diffbot, all derived from :class:`DiffbotError`, and helpers for their texts."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable
from difflib import get_close_matches

MAX_SHOWN = 200
"""[characters] Longer values from users or files are cut in a message."""
_MAX_BITS = 256
"""Larger integers are not shown in digits, because the conversion takes quadratic time."""
_MAX_NAMES = 20
"""Largest number of known names that are listed."""


class _ShortRepr(reprlib.Repr):
    """Represents a value by a text of bounded length, in bounded time."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = MAX_SHOWN
        self.maxlist = self.maxtuple = self.maxarray = self.maxdict = 10

    def repr_int(self, value: int, level: int) -> str:
        return f"<a number of {value.bit_length()} bits>" if value.bit_length() > _MAX_BITS else repr(value)


_SHORT = _ShortRepr()


class DiffbotError(Exception):
    """Base of all errors of diffbot; its text is one line for the user."""


class InvalidValueError(DiffbotError):
    """The value of a parameter, of a flag or in a file is not allowed."""

    def __init__(self, name: str, value: object, bound: str = "", sentence: str = "") -> None:
        """Create the error.

        Args:
            name: name of the field as the user knows it, e.g. ``gamma``.
            value: the value given, e.g. -1.0.
            bound: completes "must be", e.g. ``> 0``.
            sentence: replaces "must be ..." where no bound describes the problem, e.g. ``wall 0 has zero length``.
        """
        super().__init__(f"{shown(name)} = {_SHORT.repr(value)}: {sentence or f'must be {bound}'}")
        self.name = name
        self.value = value
        self.bound = bound
        self.sentence = sentence

    def __reduce__(self) -> tuple[type[InvalidValueError], tuple[str, object, str, str]]:
        """Pickle all fields; by default, only the text of an exception is pickled."""
        return type(self), (self.name, self.value, self.bound, self.sentence)


class BadMessageError(DiffbotError):
    """A received message cannot be used."""

    def __init__(self, kind: str, detail: str = "") -> None:
        """Create the error.

        Args:
            kind: short constant phrase under which such messages are counted.
            detail: the value that is wrong, for the log.
        """
        super().__init__(f"{kind}: {detail}" if detail else kind)
        self.kind = kind


def known_name(name: str, known: Iterable[str]) -> str:
    """Return the text after "must be" for an unknown name: similar names, and all known names if they are few."""
    names = sorted(known)
    similar = get_close_matches(str(name), names, 3)
    meant = f": did you mean {' or '.join(similar)}?" if similar else ""
    if similar and len(names) > _MAX_NAMES:
        return f"a known name{meant}"
    more = f" ... {len(names)} in all" if len(names) > _MAX_NAMES else ""
    return f"a known name ({', '.join(names[:_MAX_NAMES])}{more}){meant}"


def shown(value: object) -> str:
    """Return the text of a value for an error message: printable, in one line, and cut if it is long."""
    text = str(value)
    if len(text) > MAX_SHOWN:
        text = text[:MAX_SHOWN] + "..."
    return text if text.isprintable() else repr(text)
