"""The footprint of a robot: the rectangle around the boxes of its URDF, from above."""

from __future__ import annotations

import itertools
from math import cos, sin
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from diffbot_core.cdr import CdrCursor

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""Rear, front, right and left end [m] in the frame of the robot."""

MAX_URDF = 2**18
"""bytes of a URDF that is read"""
MAX_SIZE = 100.0
"""[m] of what is no misprint"""
_BASES = ("base_link", "base_footprint")
_CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3))).T


def read_footprint(data: bytes) -> Box | None:
    """Read a std_msgs/String with a URDF: see :func:`footprint_of`.

    Raises:
        CdrError: if it is none.
    """
    return footprint_of(CdrCursor(data).text()) if len(data) <= MAX_URDF else None


def footprint_of(urdf: str) -> Box | None:
    """Return the rectangle around the boxes that are fixed to the base, those of collisions before those to be seen.

    None if there are none, or if they cannot be read. A text with a document type is not read: it may grow beyond
    all bounds.
    """
    if "<!DOCTYPE" in urdf:
        return None
    try:
        corners = _corners(ElementTree.fromstring(urdf))
    except (ElementTree.ParseError, ValueError):
        return None
    if not corners or not (np.abs(corners) <= MAX_SIZE).all():
        return None
    (rear, right), (front, left) = (end(np.hstack(corners), axis=1).tolist() for end in (np.min, np.max))
    return rear, front, right, left


def _corners(robot: ElementTree.Element) -> list[Array]:
    """Return the corners (2, 8) of each box."""
    links = {link.get("name", ""): link for link in robot.findall("link")}
    joints: dict[str, list[tuple[str, Array]]] = {}
    for joint in robot.findall("joint[@type='fixed']"):
        parent, child = (
            end.get("link", "") if (end := joint.find(one)) is not None else "" for one in ("parent", "child")
        )
        joints.setdefault(parent, []).append((child, _transform(joint)))
    found = []
    waiting = [(next((name for name in (*_BASES, *links) if name in links), ""), np.eye(4))]
    while waiting:
        name, place = waiting.pop()
        if (link := links.pop(name, None)) is None:
            continue
        for part in link.findall("collision") or link.findall("visual"):
            if (box := part.find("geometry/box")) is not None:
                edges = place @ _transform(part) @ np.diag([*_numbers(box, "size"), 1.0])
                found.append(edges[:2, :3] @ _CORNERS + edges[:2, 3:])
        waiting += [(child, place @ transform) for child, transform in joints.get(name, [])]
    return found


def _transform(part: ElementTree.Element) -> Array:
    """Return the matrix (4, 4) of the origin of a joint or part: turns about fixed axes, x first, then a shift."""
    transform = np.eye(4)
    if (origin := part.find("origin")) is not None:
        r, p, y = _numbers(origin, "rpy")
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, cos(r), -sin(r)], [0.0, sin(r), cos(r)]])
        about_y = np.array([[cos(p), 0.0, sin(p)], [0.0, 1.0, 0.0], [-sin(p), 0.0, cos(p)]])
        about_z = np.array([[cos(y), -sin(y), 0.0], [sin(y), cos(y), 0.0], [0.0, 0.0, 1.0]])
        transform[:3, :3], transform[:3, 3] = about_z @ about_y @ about_x, _numbers(origin, "xyz")
    return transform


def _numbers(element: ElementTree.Element, name: str) -> list[float]:
    found = [float(word) for word in element.get(name, "0 0 0").split()]
    if len(found) != 3 or not (np.abs(found) <= MAX_SIZE).all():
        raise ValueError(name)
    return found
