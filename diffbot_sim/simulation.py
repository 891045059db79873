"""Simulation without ROS: drives to goals with the filter and the supervisor of the nodes, and the reference loop."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.config import LocalizationConfig, options_of
from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.dock import DockedPose
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurement import Measurement, heading, landmark, pose_fix
from diffbot_control.filter.odometry import OdometryConfig
from diffbot_control.goals import GoalRequest, Supervisor, SupervisorConfig
from diffbot_control.goals.record import REACHED
from diffbot_control.law.law import Law
from diffbot_control.law.regions import OMEGA_G
from diffbot_control.law.switching import SwitchingLaw
from diffbot_core.errors import BadMessageError, InvalidValueError
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import STOP, Twist
from diffbot_core.stamps import S_PER_NS
from diffbot_core.uncertainty import CERTAIN, Uncertainty
from diffbot_sim.config import WorldConfig
from diffbot_sim.fusion import SimulatedRobot, new_buffers
from diffbot_sim.noise import NoiseSource
from diffbot_sim.robot_step import EKF, FEEDBACKS, HISTORY_COLUMNS, Case, check_robot, make_loop
from diffbot_sim.sensors import purposes_of
from diffbot_sim.world import Arrivals, World

Array = NDArray[np.float64]
_MAX_DURATION = 3600.0
"""[s] longest duration of a drive, whatever the timeouts of its goal are"""
DOCK = DockedPose(0.0, 0.0, 0.0)
"""The plant detects the pose of the docked robot, so the offset from the dock is zero."""


def measurements_of(arrivals: Arrivals) -> list[Measurement]:
    """Return the measurements for the filter."""
    return [
        *(pose_fix(*one) for one in arrivals.fixes),
        *(heading(*one) for one in arrivals.headings),
        *(pose_fix(one.stamp, DOCK.robot(one.pose), DOCK.covariance(one.pose, one.R)) for one in arrivals.detections),
        *(landmark(one.stamp, one.range, one.bearing, one.R, one.landmark) for one in arrivals.landmarks),
    ]


class Drive(NamedTuple):
    """A drive to one goal: how it ended, and a row for each step."""

    goal: Pose
    end: str
    """one of record.ENDS"""
    reason: str
    """reason for the end; may be empty"""
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
        """Return True if the goal was reached."""
        return self.end == REACHED

    @property
    def duration(self) -> float:
        """Return the duration [s] of the drive."""
        return float(self.time[-1] - self.time[0])

    @property
    def error(self) -> Pose:
        """Return the true pose at the end [m, m, rad] in the goal's frame."""
        return into_frame(Pose(*self.truth[-1].tolist()), self.goal)

    @property
    def position_error(self) -> float:
        """Return the distance [m] of the true pose from the goal at the end."""
        return math.hypot(self.error.x, self.error.y)


class ClosedLoop:
    """A simulated robot with the filter and the supervisor of the nodes. A drive continues where the last one ended."""

    def __init__(
        self, world: WorldConfig, localization: LocalizationConfig, supervisor: SupervisorConfig, law: type[Law]
    ) -> None:
        """Put the robot at its start. The filter waits for its first fix."""
        self.world, self.supervisor = World(world), Supervisor(supervisor, law)
        points = tuple(world.landmarks.points().values())
        self._filter = Localization(localization, world.plant.wheels.wheel_separation, landmarks=points)
        self.estimate: Pose | None = None
        """estimated pose; None before the first fix"""
        self.uncertainty: Uncertainty = CERTAIN
        """standard deviations of the estimate"""

    @property
    def truth(self) -> Pose:
        """Return the true pose [m, m, rad] in map."""
        return self.world.state.pose

    @property
    def time(self) -> float:
        """Return the time [s] of the present state."""
        return self.world.stamp * S_PER_NS

    def sense(self) -> None:
        """Measure and update the filter. Call it once at each step."""
        self._filter.on_measurements(measurements_of(self.world.sense()))
        reading = self.world.turn_rate()
        try:
            if reading is not None and self._filter.config.filter.use_gyro:
                self._filter.on_gyro(reading)
            found = self._filter.on_odometry(self.world.odometry())
        except BadMessageError:
            return  # no fix yet
        self.estimate, self.uncertainty = found.pose, uncertainty_of(found.P)

    def drive(self, goal: Pose) -> Drive:
        """Drive to a goal in map until the supervisor ends the goal, reached or not."""
        supervisor, began = self.supervisor, self.time
        supervisor.on_goal(goal, GoalRequest(source="simulation", time=began))
        rows, regions, reached = [], [], []
        while supervisor.goals.present is not None:
            self.sense()
            command = self._command(began)
            estimate = self.estimate or Pose(math.nan, math.nan, math.nan)
            rows.append((self.time, *self.world.state.pose, *estimate, *command, self.uncertainty.xy))
            regions.append(OMEGA_G if supervisor.report is None else supervisor.report.region)
            reached.append(supervisor.memory.reached)
            self.world.advance(command)
        end, table = supervisor.goals.ended[-1], np.array(rows, dtype=np.float64)
        time, truth, estimated, commands, sigmas = np.split(table, (1, 4, 7, 9), axis=1)
        flags = np.array(regions), np.array(reached)
        return Drive(goal, end.end, end.reason, time[:, 0], truth, estimated, commands, sigmas[:, 0], *flags)

    def _command(self, began: float) -> Twist:
        now, supervisor = self.time, self.supervisor
        if now - began > _MAX_DURATION:
            supervisor.give_up(f"not reached within {_MAX_DURATION:g} s")
        if self.estimate is None:
            return supervisor.on_tick(now) or STOP
        return supervisor.on_pose(self.world.stamp, now, self.estimate, self.uncertainty) or STOP


class LoopRecord(NamedTuple):
    """One run of the reference loop, with a row for each step."""

    time: Array
    """(n,) [s]"""
    truth: Array
    """(n, 3) true pose [m, m, rad]"""
    feedback: Array
    """(n, 3) pose that the controller receives; nan before the first pose"""
    command: Array
    """(n, 2) v, omega of the command that answers this pose [m/s, rad/s]"""
    region: NDArray[np.int64]
    """(n,) 0: Omega_G, 1: Omega_L"""
    reached: NDArray[np.bool_]
    """(n,) True once the controller reports the goal as reached"""
    sigma: Array
    """(n,) [m] standard deviation of the estimated position; 0 for feedback other than the filter's"""


def simulated_robot(world: WorldConfig, localization: LocalizationConfig | None = None) -> SimulatedRobot:
    """Return plant, sensors, filter and landmarks of the robot in a world."""
    points = tuple(world.landmarks.points().values())
    options = options_of(localization or LocalizationConfig(), world.plant.wheels.wheel_separation, points)
    return SimulatedRobot(world.plant, world.sensors, options, np.array(points, dtype=np.float64).reshape(-1, 2))


def simulate(
    world: WorldConfig,
    controller: Any,
    goal: Pose,
    steps: int,
    feedback: str = EKF,
    localization: LocalizationConfig | None = None,
    law: type[Law] = SwitchingLaw,
) -> LoopRecord:
    """Simulate the closed loop for ``steps`` sampling times by the batch engine's loop, run as plain Python.

    In each step, as in the graph, the sensors deliver, the filter answers the odometry with a pose, the controller
    answers the pose with a command, and the plant holds the command for one sampling time.

    Raises:
        InvalidValueError: if the feedback is not one of FEEDBACKS, for less than one step, for odometry options other
            than the defaults, or for a robot that :func:`robot_step.check_robot` refuses.
    """
    if localization is not None and localization.odometry != OdometryConfig():
        raise InvalidValueError("odometry", tuple(localization.odometry), "the default in this simulation")
    if feedback not in FEEDBACKS:
        raise InvalidValueError("feedback", feedback, "one of " + ", ".join(FEEDBACKS))
    if steps < 1:
        raise InvalidValueError("steps", steps, ">= 1")
    robot = simulated_robot(world, localization)
    case = Case(robot, controller, goal, FEEDBACKS.index(feedback), False, steps, math.inf, math.inf)
    check_robot(robot, (localization or LocalizationConfig()).history_length)
    purposes = purposes_of(world.sensors, len(robot.landmarks), world.plant.slip_noise)
    noise = NoiseSource().run(world.seed, world.run, steps + 1, purposes)
    rows: Array = np.empty((steps + 1, len(HISTORY_COLUMNS)))
    make_loop(law, case.feedback)(case, new_buffers(robot), noise, Pose(*world.start), rows)
    time: Array = np.arange(steps + 1) * np.float64(world.plant.sampling_time)
    flags = rows[:, 10].astype(np.int64), rows[:, 11] > 0.0
    return LoopRecord(time, rows[:, 0:3], rows[:, 3:6], rows[:, 6:8], *flags, rows[:, 8])
