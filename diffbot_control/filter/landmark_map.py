"""The map of landmarks: points whose range and bearing the robot can measure."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE, Point
from diffbot_core.schema import Spec, known_fields

_NUMBERS = 2**31
"""Bound of the numbers, which are sent as int32."""


@known_fields
class LandmarkMap(NamedTuple):
    """Landmarks: three lists of equal length, an entry per landmark."""

    landmark_ids: Annotated[
        tuple[int, ...],
        Spec("id of each known landmark", minimum=-_NUMBERS, maximum=_NUMBERS - 1, read_only=True),
    ] = ()
    landmark_x: Annotated[
        tuple[float, ...],
        Spec("x of each known landmark, in map", "m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE, read_only=True),
    ] = ()
    landmark_y: Annotated[
        tuple[float, ...],
        Spec("y of each known landmark, in map", "m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE, read_only=True),
    ] = ()

    def check(self) -> None:
        """Refuse inconsistent lists.

        Raises:
            InvalidValueError: if their lengths differ, or two landmarks have the same number.
        """
        count = len(self.landmark_ids)
        if len(set(self.landmark_ids)) != count:
            raise InvalidValueError("landmark_ids", list(self.landmark_ids), "different numbers")
        for name, values in (("landmark_x", self.landmark_x), ("landmark_y", self.landmark_y)):
            if len(values) != count:
                raise InvalidValueError(name, list(values), f"as many as landmark_ids: {count}")

    def points(self) -> dict[int, Point]:
        """Return the positions [m] by number, ordered by position: measurements of one time are fused in this order."""
        positions = map(Point, self.landmark_x, self.landmark_y)
        return dict(sorted(zip(self.landmark_ids, positions, strict=True), key=lambda one: one[1]))
