"""The badges of the README: each says what the package's own metadata says."""

from __future__ import annotations

import re
from importlib.metadata import metadata
from typing import NamedTuple

from anybadge import Badge

from diffbot_core.distribution import DISTRIBUTION

_BLUE, _GREEN = "#3f51b5", "#2e7d32"
_VERSION = re.compile(r"Programming Language :: Python :: (3\.\d+)")


class _Fact(NamedTuple):
    label: str
    value: str
    colour: str


def badges() -> dict[str, str]:
    """Return the SVG of each badge by the name of its file."""
    found = {}
    for name, one in _facts().items():
        picture = Badge(label=one.label, value=one.value, default_color=one.colour).badge_svg_text
        # The library numbers its badges; the same file every time needs a name.
        found[f"{name}.svg"] = re.sub(r"anybadge_\d+", f"badge_{name}", picture)
    return found


def _facts() -> dict[str, _Fact]:
    about = metadata(DISTRIBUTION)
    versions = [found[1] for one in about.get_all("Classifier", []) if (found := _VERSION.fullmatch(one))]
    # rclpy comes from the wheels of one distribution of ROS.
    (distribution,) = {
        found[1] for one in about.get_all("Requires-Dist", []) if (found := re.match(r"ros-(\w+)-rclpy\b", one))
    }
    return {
        "ros": _Fact("ROS 2", distribution.capitalize(), _BLUE),
        "python": _Fact("Python", f"{versions[0]} to {versions[-1]}", _BLUE),
        "licence": _Fact("licence", about["License"], _GREEN),
        "version": _Fact("version", about["Version"], _BLUE),
    }
