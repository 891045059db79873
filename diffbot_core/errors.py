"""Exceptions that diffbot raises on purpose; all derive from :class:`DiffbotError`."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable
from difflib import get_close_matches

_MAX_BITS = 256
"""of a whole number that is shown: the digits of larger ones take Python quadratic time"""
_MAX_NAMES = 20
"""known names that are listed"""


class _ShortRepr(reprlib.Repr):
    """Shows a value in a bounded length, and looks at a bounded part of it."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = 200
        self.maxlist = self.maxtuple = self.maxarray = self.maxdict = 10

    def repr_int(self, value: int, level: int) -> str:
        return f"<a number of {value.bit_length()} bits>" if value.bit_length() > _MAX_BITS else repr(value)


_SHORT = _ShortRepr()


class DiffbotError(Exception):
    """Base of all errors of this package; its text is one line, meant to be shown to a user."""


class InvalidValueError(DiffbotError):
    """A value from outside (parameter, file, flag) that breaks its bound."""

    def __init__(self, name: str, value: object, bound: str) -> None:
        """Name the field, the value it got and the bound it breaks, e.g. ``("gamma", -1.0, "> 0")``."""
        super().__init__(f"{_short_name(name)} = {_SHORT.repr(value)}: must be {bound}")
        self.name = name
        self.value = value
        self.bound = bound

    def __reduce__(self) -> tuple[type[InvalidValueError], tuple[str, object, str]]:
        """Keep all fields when pickled: by default an exception is rebuilt from its text alone."""
        return type(self), (self.name, self.value, self.bound)


class ReplacedNameError(InvalidValueError):
    """A parameter given under a name that another one has replaced; see ``Spec.replaces``."""

    def __init__(self, name: str, value: object, successor: str, bound: str) -> None:
        """Name the old parameter, the value it got, the new parameter and the values that one takes."""
        super().__init__(name, value, bound)
        self.args = (f"{name} = {_SHORT.repr(value)}: was replaced by {successor} ({bound})",)
        self.successor = successor

    def __reduce__(self) -> tuple[type[ReplacedNameError], tuple[str, object, str, str]]:  # type: ignore[override]
        """Keep all four fields when pickled; see :class:`InvalidValueError`."""
        return type(self), (self.name, self.value, self.successor, self.bound)


def known_name(name: str, known: Iterable[str]) -> str:
    """Return the bound of a name that is not among the ``known`` ones: those like it, and the list if it is short."""
    names = sorted(known)
    similar = get_close_matches(str(name), names, 3)
    meant = f": did you mean {' or '.join(similar)}?" if similar else ""
    if similar and len(names) > _MAX_NAMES:
        return f"a known name{meant}"
    more = f" ... {len(names)} in all" if len(names) > _MAX_NAMES else ""
    return f"a known name ({', '.join(names[:_MAX_NAMES])}{more}){meant}"


def _short_name(name: str) -> str:
    """Return a name as it is; one from outside may have any length and any characters."""
    return name if len(name) <= _SHORT.maxstring and name.isprintable() else _SHORT.repr(name)


class BadMessageError(DiffbotError):
    """A message that cannot be used; ``kind`` is a short stable phrase under which it is counted."""

    def __init__(self, kind: str, detail: str = "") -> None:
        """Give the stable ``kind`` (a counter's name) and, for the log, the offending value."""
        super().__init__(f"{kind}: {detail}" if detail else kind)
        self.kind = kind
