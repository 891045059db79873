"""Run the benchmark with your own law: turn towards the goal, drive to it, turn to its heading.

    python examples/straight_line.py --runs 20 --case nominal --out benchmark

Needs the extra `batch`. docs/how-to/own-law.md explains the interface of a law.
"""

import math
import sys
from typing import Annotated, NamedTuple

from diffbot_control.law import GoalTolerance, Law, Report, limit_velocity
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import into_frame, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec


class Config(NamedTuple):
    """Parameters, with text, unit and range; every law has a data sheet and tolerances."""

    data_sheet: DataSheet = DataSheet()
    tolerance: GoalTolerance = GoalTolerance()
    distance_gain: Annotated[float, Spec("speed per distance", "1/s", 0.1, 10.0)] = 1.0
    turn_gain: Annotated[float, Spec("rate per angle", "1/s", 0.1, 10.0)] = 2.0


class Memory(NamedTuple):
    """State of the law between two steps. Each law needs ``reached``; the other fields are its own."""

    arrived: bool
    reached: bool


class StraightLine(Law):
    """Turn towards the goal, drive there, turn to its heading."""

    name = "straight_line"
    Config = Config

    @staticmethod
    def new_memory(config):
        """Return the memory at the start of a goal. Compiled code has no defaults, so give all fields."""
        return Memory(False, False)

    @staticmethod
    def step(memory, observation, goal, config):
        """Return the next memory, the command and a report for a pose."""
        x, y, theta = into_frame(observation.estimate.pose, goal)
        rho, beta = math.hypot(x, y), math.atan2(-y, -x)
        alpha = wrap_angle(beta - theta)
        arrived = memory.arrived or rho < 0.4 * config.tolerance.xy_goal_tolerance
        reached = memory.reached or (arrived and abs(theta) < 0.3 * config.tolerance.yaw_goal_tolerance)
        angle, v = (-theta, 0.0) if arrived else (alpha, config.distance_gain * rho * max(math.cos(alpha), 0.0))
        command = Twist(0.0, 0.0) if reached else limit_velocity(Twist(v, config.turn_gain * angle), config.data_sheet)
        return Memory(arrived, reached), command, Report(rho, alpha, beta, theta, 0.0, 0, 0.0)


if __name__ == "__main__":
    from diffbot_tools.cli import main

    sys.exit(main(["benchmark", "switching", "--law", "straight_line:StraightLine", *sys.argv[1:]]))
