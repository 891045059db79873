"""Parameters of the node ``demo``."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.ranges import POSITION, TIME, TIMEOUT
from diffbot_core.schema import Spec


class DemoNodeConfig(NamedTuple):
    """Parameters of the node ``demo``."""

    goals: Annotated[
        tuple[float, ...],
        Spec("x, y, heading of each goal in map, in order", "m, m, rad", *POSITION, read_only=True),
    ] = (0.0, 0.0, 0.0)
    recorded_topics: Annotated[
        tuple[str, ...],
        Spec("topics that the recorder must be subscribed to before the start", read_only=True),
    ] = ()
    hold: Annotated[float, Spec("time to stay at a reached goal", "s", *TIME, read_only=True)] = 3.0
    goal_timeout: Annotated[
        float,
        Spec("time to reach a goal before giving up", "s", *TIMEOUT, read_only=True),
    ] = 120.0
    pause_at_end: Annotated[
        bool, Spec("stop simulated time after the last goal; else the robot takes further goals", read_only=True)
    ] = True
    map_frame: Annotated[str, Spec("frame of the goals", read_only=True)] = "map"

    def check(self) -> None:
        """Check that the goals are triples.

        Raises:
            InvalidValueError: if they are not.
        """
        if not self.goals or len(self.goals) % 3:
            raise InvalidValueError("goals", list(self.goals), "triples x, y, heading")
