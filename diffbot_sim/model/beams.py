"""Beams of the simulated robot: the true distance to the nearest wall, and its error."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.filter.wall_map import Wall, WallMap
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.schema import Spec, known_fields
from diffbot_sim.model.philox import NoiseKey, draw
from diffbot_sim.model.sensors import uniform_variance

_BEAM_BLOCK = 8
"""of the first beam, see :mod:`philox`; there are at most eight"""
MIN_RANGE = 0.02
"""[m]"""


@known_fields
class BeamSimulation(NamedTuple):
    """Beams of the plant."""

    map: WallMap = WallMap()
    beam_rate: Annotated[float, Spec("rate of each beam", "Hz", minimum=0.0, maximum=1000.0)] = 10.0
    beam_error_max: Annotated[float, Spec("bound of the error of a range", "m", minimum=0.0, maximum=10.0)] = 0.03
    beam_max_range: Annotated[float, Spec("a wall farther away gives no echo", "m", minimum=0.1, maximum=1e3)] = 8.0

    def variance(self) -> float:
        """Return the variance of a range [m^2]."""
        return uniform_variance(self.beam_error_max)


def true_range(pose: Pose, beam: Pose, walls: tuple[Wall, ...]) -> float:
    """Return the distance [m] along a beam to the nearest wall, inf if there is none.

    The ends of each wall are turned into the frame of the beam, whose x axis the wall may cross.

    Args:
        pose: of the robot, in map.
        beam: origin and direction in the frame of the robot.
        walls: of the map.
    """
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    origin = Pose(pose.x + c * beam.x - s * beam.y, pose.y + s * beam.x + c * beam.y, pose.theta + beam.theta)
    nearest = math.inf
    for wall in walls:
        (x1, y1, _), (x2, y2, _) = (into_frame(Pose(end.x, end.y, 0.0), origin) for end in wall)
        if y1 != y2 and y1 * y2 <= 0.0:
            crossing = x1 - y1 * (x2 - x1) / (y2 - y1)
            if crossing > 0.0:
                nearest = min(nearest, crossing)
    return nearest


def measured_range(key: NoiseKey, index: int, distance: float, config: BeamSimulation) -> float:
    """Return what beam ``index`` measures of a true ``distance`` [m]; inf without an echo."""
    if distance > config.beam_max_range:
        return math.inf
    noise = draw(key.seed, key.run, key.step, _BEAM_BLOCK + index).a
    return max(distance + config.beam_error_max * noise, MIN_RANGE)
