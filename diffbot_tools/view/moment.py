"""The moment and view of a link that is copied from the page (page/share.js)."""

from __future__ import annotations

from itertools import chain
from math import isfinite
from typing import NamedTuple
from urllib.parse import parse_qs

from diffbot_core.errors import InvalidValueError


class Moment(NamedTuple):
    """What a link of the page leads to; None: all of it."""

    robot: str | None = None
    time: float | None = None
    """[s]"""
    view: tuple[float, float, float] | None = None
    """x and y [m] in the middle of the map, and pixels per metre"""
    zoom: tuple[float, float] | None = None
    """[s] that the charts show"""


def moment_of(link: str) -> Moment:
    """Return the moment of a link that the page has copied, or of what stands behind its ``#``.

    Raises:
        InvalidValueError: if it is none.
    """
    found = {name: texts[0] for name, texts in parse_qs(link.rpartition("#")[2]).items()}
    try:
        numbers = {
            name: [float(word) for word in found[name].split(",")] for name in ("t", "map", "zoom") if name in found
        }
        (time,) = numbers.get("t", [None])
        x, y, scale = numbers.get("map", [0.0, 0.0, 1.0])
        begin, end = numbers.get("zoom", [0.0, 1.0])
    except ValueError:
        raise InvalidValueError("--at", link, "a link copied from the page") from None
    if not numbers or not all(map(isfinite, chain(*numbers.values()))) or scale <= 0.0 or end <= begin:
        raise InvalidValueError("--at", link, "a link copied from the page")
    view, zoom = (x, y, scale) if "map" in numbers else None, (begin, end) if "zoom" in numbers else None
    return Moment(found.get("robot"), time, view, zoom)
