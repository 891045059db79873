"""Drives to goals, simulated as a whole without ROS: plant, filter, law, and the supervisor that answers each goal."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.goals import GoalRequest, Law, Supervisor, SupervisorConfig
from diffbot_control.goals.goal_record import REACHED
from diffbot_control.law.regions import OMEGA_G
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import CERTAIN, Uncertainty
from diffbot_core.units import S_PER_NS
from diffbot_sim.feedback import EKF
from diffbot_sim.model.simulator import World, WorldConfig
from diffbot_sim.reference_loop import Array, PoseFeedback

_STOP = Twist(0.0, 0.0)
_LONGEST = 3600.0
"""[s] after which a goal is given up, whatever its timeouts are"""


class Drive(NamedTuple):
    """One goal, how it ended, and a row for each step from its acceptance to its answer."""

    goal: Pose
    end: str
    """one of goal_record.ENDS"""
    reason: str
    """of the end, where there is more to say"""
    time: Array
    """(n,) [s]"""
    truth: Array
    """(n, 3) true pose [m, m, rad]"""
    estimate: Array
    """(n, 3) estimated pose; nan before the first fix"""
    command: Array
    """(n, 2) v, omega [m/s, rad/s]"""
    sigma: Array
    """(n,) [m] standard deviation of the estimated position"""
    region: NDArray[np.int64]
    """(n,) 0: Omega_G, 1: Omega_L"""
    reached: NDArray[np.bool_]
    """(n,) True once the goal counts as reached"""

    @property
    def is_reached(self) -> bool:
        """True if the answer is that the goal is reached."""
        return self.end == REACHED

    @property
    def duration(self) -> float:
        """Time [s] until the answer."""
        return float(self.time[-1] - self.time[0])

    @property
    def error(self) -> Pose:
        """The true pose at the answer [m, m, rad], in the goal's frame."""
        return into_frame(Pose(*self.truth[-1].tolist()), self.goal)

    @property
    def position_error(self) -> float:
        """Distance [m] of the true pose from the goal at the answer."""
        return math.hypot(self.error.x, self.error.y)


class Simulation:
    """A simulated robot; time goes on from drive to drive."""

    def __init__(
        self, world: WorldConfig, localization: LocalizationConfig, supervisor: SupervisorConfig, law: Law
    ) -> None:
        """Put the robot at its start, with a filter that waits for its first fix."""
        self.world, self.supervisor = World(world), Supervisor(supervisor, law)
        separation, landmarks = world.plant.wheels.wheel_separation, bool(world.landmarks.landmark_ids)
        self._source = PoseFeedback(EKF, Localization(localization, separation, landmarks=landmarks))
        self.estimate: Pose | None = None
        """None before the first fix"""

    @property
    def uncertainty(self) -> Uncertainty:
        """Standard deviations of the estimate."""
        return self._source.uncertainty() if self.estimate is not None else CERTAIN

    @property
    def truth(self) -> Pose:
        """The true pose [m, m, rad] in map."""
        return self.world.state.pose

    @property
    def time(self) -> float:
        """Time [s] of the present state."""
        return self.world.stamp * S_PER_NS

    def sense(self) -> None:
        """Sense and filter at the present step; once a step."""
        self.estimate = self._source.pose(self.world) or self.estimate

    def drive(self, goal: Pose) -> Drive:
        """Drive to a goal in map until it is answered: reached, or not and why."""
        supervisor, began = self.supervisor, self.time
        supervisor.on_goal(goal, GoalRequest(source="simulation", time=began))
        rows, regions, reached = [], [], []
        while supervisor.goals.present is not None:
            self.sense()
            command = self._command(began)
            estimate, sigma = self.estimate or Pose(*[math.nan] * 3), self.uncertainty.xy
            rows.append((self.time, *self.world.state.pose, *estimate, *command, sigma))
            regions.append(OMEGA_G if supervisor.report is None else supervisor.report.region)
            reached.append(supervisor.memory.reached)
            self.world.advance(command)
        end, table = supervisor.goals.ended[-1], np.array(rows, dtype=np.float64)
        time, truth, estimated, commands, sigmas = np.split(table, (1, 4, 7, 9), axis=1)
        flags = np.array(regions), np.array(reached)
        return Drive(goal, end.end, end.reason, time[:, 0], truth, estimated, commands, sigmas[:, 0], *flags)

    def _command(self, began: float) -> Twist:
        now, supervisor = self.time, self.supervisor
        if now - began > _LONGEST:
            supervisor.give_up(f"not reached within {_LONGEST:g} s")
        if self.estimate is None:
            return supervisor.on_tick(now, elapsed=now - began) or _STOP
        return supervisor.on_pose(self.world.stamp, now, self.estimate, self.uncertainty) or _STOP
