"""Exceptions that diffbot raises on purpose, all derived from :class:`DiffbotError`, and texts for their messages."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable
from difflib import get_close_matches

MAX_SHOWN = 200
"""characters of a text from outside in a message"""
_MAX_BITS = 256
"""of a whole number that is shown: the digits of larger ones take Python quadratic time"""
_MAX_NAMES = 20
"""known names that are listed"""


class _ShortRepr(reprlib.Repr):
    """Shows a value in a bounded length, and looks at a bounded part of it."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = MAX_SHOWN
        self.maxlist = self.maxtuple = self.maxarray = self.maxdict = 10

    def repr_int(self, value: int, level: int) -> str:
        return f"<a number of {value.bit_length()} bits>" if value.bit_length() > _MAX_BITS else repr(value)


_SHORT = _ShortRepr()


class DiffbotError(Exception):
    """Base of all errors of this package; its text is one line, meant to be shown to a user."""


class InvalidValueError(DiffbotError):
    """A value from outside (parameter, file, flag) that is not allowed."""

    def __init__(self, name: str, value: object, bound: str = "", sentence: str = "") -> None:
        """Name the field, its value and what is wrong.

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
        """Keep all fields when pickled: by default an exception is rebuilt from its text alone."""
        return type(self), (self.name, self.value, self.bound, self.sentence)


class BadMessageError(DiffbotError):
    """A message that cannot be used; ``kind`` is a short stable phrase under which it is counted."""

    def __init__(self, kind: str, detail: str = "") -> None:
        """Give the stable ``kind`` (a counter's name) and, for the log, the offending value."""
        super().__init__(f"{kind}: {detail}" if detail else kind)
        self.kind = kind


def known_name(name: str, known: Iterable[str]) -> str:
    """Return the bound of a name that is not among the ``known`` ones: similar names, and the list if it is short."""
    names = sorted(known)
    similar = get_close_matches(str(name), names, 3)
    meant = f": did you mean {' or '.join(similar)}?" if similar else ""
    if similar and len(names) > _MAX_NAMES:
        return f"a known name{meant}"
    more = f" ... {len(names)} in all" if len(names) > _MAX_NAMES else ""
    return f"a known name ({', '.join(names[:_MAX_NAMES])}{more}){meant}"


def shown(value: object) -> str:
    """Return a text from outside as it can stand in a message of one line: printable, and of a bounded length."""
    text = str(value)
    if len(text) > MAX_SHOWN:
        text = text[:MAX_SHOWN] + "..."
    return text if text.isprintable() else repr(text)
