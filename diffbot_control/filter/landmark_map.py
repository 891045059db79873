"""The map of landmarks: points whose range and bearing the robot can measure."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE
from diffbot_core.schema import Spec

_NUMBERS = 2**31
"""Numbers are sent as int32."""


class LandmarkMap(NamedTuple):
    """Landmarks by their numbers; the three lists belong together."""

    landmark_ids: Annotated[
        tuple[int, ...],
        Spec("number of each known landmark", minimum=-_NUMBERS, maximum=_NUMBERS - 1, read_only=True),
    ] = ()
    landmark_x: Annotated[
        tuple[float, ...],
        Spec("x of each, in map", "m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE, read_only=True),
    ] = ()
    landmark_y: Annotated[
        tuple[float, ...],
        Spec("y of each, in map", "m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE, read_only=True),
    ] = ()

    def check(self) -> None:
        """Refuse lists that do not belong together.

        Raises:
            InvalidValueError: if they differ in length, or two landmarks have one number.
        """
        count = len(self.landmark_ids)
        if len(set(self.landmark_ids)) != count:
            raise InvalidValueError("landmark_ids", list(self.landmark_ids), "different numbers")
        for name, values in (("landmark_x", self.landmark_x), ("landmark_y", self.landmark_y)):
            if len(values) != count:
                raise InvalidValueError(name, list(values), f"as many as landmark_ids: {count}")

    def points(self) -> dict[int, tuple[float, float]]:
        """Return x, y [m] by number, in the order of the places, in which sightings of one time are fused."""
        places = zip(self.landmark_x, self.landmark_y, strict=True)
        return dict(sorted(zip(self.landmark_ids, places, strict=True), key=lambda one: one[1]))


def linearisation_variance(squared: float, spread: float) -> tuple[float, float]:
    """Variances of what the derivatives of range [m^2] and bearing [rad^2] leave out.

    They are taken at the believed place; a landmark that is no farther than the belief is wide is seen at quite another
    range and bearing from elsewhere in it. The second-order terms are t^2 / (2 d) and t l / d^2 for errors l along the
    line of sight and t across.

    Args:
        squared: d^2 [m^2], squared distance of the believed place.
        spread: P_xx + P_yy [m^2], of which neither variance is more.
    """
    return spread * spread / (2.0 * squared), spread * spread / (squared * squared)


def range_and_bearing(x: float, y: float, theta: float, point_x: float, point_y: float) -> tuple[float, float]:
    """Range [m] and bearing [rad], not wrapped, of a point as a robot at ``x``, ``y``, ``theta`` sees it."""
    return math.hypot(point_x - x, point_y - y), math.atan2(point_y - y, point_x - x) - theta
