"""The map of walls, and the beams by which a robot measures the distance to them."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.filter.pose_sources import TOPIC_NAME
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE, Point, Pose
from diffbot_core.schema import Spec, known_fields

_MAX_BEAMS = 8


class Wall(NamedTuple):
    """A segment of the map."""

    start: Point
    """[m]"""
    end: Point
    """[m]"""


@known_fields
class WallMap(NamedTuple):
    """Walls and beams: lists with an entry per wall, and lists with an entry per beam."""

    wall_x1: Annotated[
        tuple[float, ...],
        Spec("x of one end of each wall, in map", "m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE, read_only=True),
    ] = ()
    wall_y1: Annotated[
        tuple[float, ...],
        Spec("y of the same end", "m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE, read_only=True),
    ] = ()
    wall_x2: Annotated[
        tuple[float, ...],
        Spec("x of the other end of each wall", "m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE, read_only=True),
    ] = ()
    wall_y2: Annotated[
        tuple[float, ...],
        Spec("y of the other end", "m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE, read_only=True),
    ] = ()
    beam_topics: Annotated[
        tuple[str, ...],
        Spec("topics of beams (sensor_msgs/Range) that measure the distance to walls, e.g. [range]", read_only=True),
    ] = ()
    beam_x: Annotated[
        tuple[float, ...],
        Spec("x of each beam's origin, in base_link", "m", minimum=-10.0, maximum=10.0, read_only=True),
    ] = ()
    beam_y: Annotated[
        tuple[float, ...],
        Spec("y of each beam's origin, in base_link", "m", minimum=-10.0, maximum=10.0, read_only=True),
    ] = ()
    beam_yaw: Annotated[
        tuple[float, ...],
        Spec("direction of each beam, in base_link", "rad", minimum=-math.pi, maximum=math.pi, read_only=True),
    ] = ()

    def check(self) -> None:
        """Refuse lists that do not fit together, names that are no topics, and walls without a length.

        Raises:
            InvalidValueError: naming the list, its value and what it has to be.
        """
        topics = self.beam_topics
        if len(topics) > _MAX_BEAMS or len(set(topics)) != len(topics) or not all(map(TOPIC_NAME.fullmatch, topics)):
            raise InvalidValueError("beam_topics", list(topics), f"at most {_MAX_BEAMS} different names of topics")
        for names in (self._fields[:4], self._fields[4:]):
            for name in names[1:]:
                values = getattr(self, name)
                if len(values) != len(getattr(self, names[0])):
                    raise InvalidValueError(name, list(values), f"as many as {names[0]}")
        for number, (start, end) in enumerate(self.walls()):
            if start == end:
                raise InvalidValueError("wall_x1", list(self.wall_x1), f"wall {number} with a length")

    def walls(self) -> tuple[Wall, ...]:
        """Return the walls."""
        ends = zip(self.wall_x1, self.wall_y1, self.wall_x2, self.wall_y2, strict=False)
        return tuple(Wall(Point(x1, y1), Point(x2, y2)) for x1, y1, x2, y2 in ends)

    def beams(self) -> dict[str, Pose]:
        """Return origin and direction of each beam in the frame of the robot, by its topic."""
        mounts = zip(self.beam_x, self.beam_y, self.beam_yaw, strict=False)
        return {topic: Pose(*mount) for topic, mount in zip(self.beam_topics, mounts, strict=False)}


@known_fields
class BeamConfig(NamedTuple):
    """What the filter knows of beams."""

    map: WallMap = WallMap()
    beam_sigma: Annotated[
        float,
        Spec("deviation of a range without a variance; 0: drop it", "m", minimum=0.0, maximum=1e3),
    ] = 0.0
