"""Plant, filter and controller in one loop without ROS: the reference for the graph."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.dock import Mounting
from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.localization import FilterEstimate, Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import Heading, LandmarkMeasurement, Measurement, PoseFix
from diffbot_control.law.controller import ControllerConfig, ControllerMemory, step
from diffbot_core.errors import BadMessageError, InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty
from diffbot_sim.feedback import EKF, FEEDBACKS, RAW, TRUTH
from diffbot_sim.model.outcome import Criteria, LawState, Outcome, add_step, new_totals, outcome_of
from diffbot_sim.model.sensors import check_detector
from diffbot_sim.model.simulator import Arrivals, World, WorldConfig

Array = NDArray[np.float64]


class Recording(NamedTuple):
    """One run, a row per sampling time from 0 on."""

    time: Array
    """(n,) [s]"""
    truth: Array
    """(n, 3) true pose [m, m, rad]"""
    feedback: Array
    """(n, 3) pose given to the controller; nan before there is one"""
    command: Array
    """(n, 2) v, omega of the command that follows [m/s, rad/s]"""
    region: NDArray[np.int64]
    """(n,) region in force"""
    reached: NDArray[np.bool_]
    """(n,) True once the controller has reported the goal as reached"""
    sigma: Array
    """(n,) [m] standard deviation of the position given to the controller; 0 for a feedback without one"""

    def outcome(self, goal: Pose, xy_tolerance: float, yaw_tolerance: float) -> Outcome:
        """Return what a batch keeps of such a run.

        Args:
            goal: of the run, in map.
            xy_tolerance: [m] for the settling time.
            yaw_tolerance: [rad] for the settling time.
        """
        steps = len(self.time) - 1
        sampling_time = float(self.time[1] - self.time[0])
        criteria = Criteria(goal, xy_tolerance, yaw_tolerance, sampling_time, steps)
        poses = [Pose(*row) for row in self.truth.tolist()]
        totals = new_totals()
        rows = zip(self.region.tolist(), self.reached.tolist(), self.command.tolist(), strict=True)
        for index, (region, reached, row) in enumerate(rows):
            after = poses[min(index + 1, steps)]
            law = LawState(region, reached)
            totals = add_step(totals, criteria, index, law, Twist(*row), poses[index], after)
        feedback = Pose(*self.feedback[-1].tolist())
        return outcome_of(totals, criteria, feedback, not math.isnan(feedback.x), poses[-1])


def simulate(
    world_config: WorldConfig,
    controller: ControllerConfig,
    goal: Pose,
    steps: int,
    feedback: str = EKF,
    localization: LocalizationConfig | None = None,
) -> Recording:
    """Run the closed loop for ``steps`` sampling times.

    In each, as in the graph: the sensors deliver, the filter answers the odometry with a pose, the controller answers
    the pose with a command, the plant holds it for one sampling time.

    Raises:
        InvalidValueError: for a feedback that is none of FEEDBACKS, or less than one step; see :func:`check_detector`.
    """
    if feedback not in FEEDBACKS:
        raise InvalidValueError("feedback", feedback, "one of " + ", ".join(FEEDBACKS))
    if steps < 1:
        raise InvalidValueError("steps", steps, ">= 1")
    check_detector(world_config.sensors)
    world = World(world_config)
    separation = world_config.plant.wheels.wheel_separation
    landmarks = bool(world_config.landmarks.landmark_ids)
    found = Localization(localization or LocalizationConfig(), separation, landmarks=landmarks)
    source = PoseFeedback(feedback, found)
    memory, t_s = ControllerMemory(), world_config.plant.sampling_time
    rows: Array = np.full((steps + 1, 9), np.nan)
    regions, reached = np.zeros(steps + 1, dtype=np.int64), np.zeros(steps + 1, dtype=np.bool_)
    for index in range(steps + 1):
        pose = source.pose(world)
        command = Twist(0.0, 0.0)
        if pose is not None:
            estimate = Estimate(pose, source.uncertainty())
            memory, command, _ = step(memory, estimate, goal, t_s if index else 0.0, controller)
            rows[index, 3:6], rows[index, 8] = pose, estimate.uncertainty.xy
        rows[index, 0:3], rows[index, 6:8] = world.state.pose, command
        regions[index] = memory.switching.region
        reached[index] = memory.settling.reached
        if index < steps:
            world.advance(command)
    time: Array = np.arange(steps + 1) * np.float64(t_s)
    return Recording(time, rows[:, 0:3], rows[:, 3:6], rows[:, 6:8], regions, reached, rows[:, 8])


DOCK = Mounting(Pose(0.0, 0.0, 0.0), Pose(0.0, 0.0, 0.0))
"""The plant's detector measures where the docked robot will stand, in the robot's frame."""


def measurements_of(arrivals: Arrivals) -> list[Measurement]:
    """Return what the filter gets of the plant's readings."""
    return [
        *(PoseFix(*one) for one in arrivals.fixes),
        *(Heading(*one) for one in arrivals.headings),
        *(PoseFix(one.stamp, DOCK.robot(one.pose), DOCK.covariance(one.pose, one.R)) for one in arrivals.detections),
        *(LandmarkMeasurement(one.stamp, one.range, one.bearing, one.R, one.landmark) for one in arrivals.landmarks),
    ]


class PoseFeedback:
    """Source of the poses that the controller gets."""

    def __init__(self, feedback: str, localization: Localization) -> None:
        """Begin without a pose.

        Args:
            feedback: one of FEEDBACKS.
            localization: the filter, asked with EKF only.
        """
        self._feedback = feedback
        self._localization = localization
        self._newest: Pose | None = None
        self._estimate: FilterEstimate | None = None

    def pose(self, world: World) -> Pose | None:
        """Return the pose at the present step, None before there is one; to be called once a step."""
        arrivals = world.sense()
        if self._feedback == TRUTH:
            return world.state.pose
        if self._feedback == RAW:
            for fix in arrivals.fixes:
                self._newest = fix.pose
            return self._newest
        for measurement in measurements_of(arrivals):
            try:
                self._localization.on_measurement(measurement)
            except BadMessageError:
                continue  # too late for the filter's history, or a heading before the first fix: as the node drops it
        reading = world.turn_rate()
        try:
            if reading is not None and self._localization.config.filter.use_gyro:
                self._localization.on_gyro(GyroSample(*reading))
            self._estimate = self._localization.on_odometry(world.odometry())
        except BadMessageError:
            return None  # no fix yet
        return self._estimate.pose

    def uncertainty(self) -> Uncertainty:
        """Return the standard deviations of the newest pose; fixes and true poses come without any."""
        return CERTAIN if self._estimate is None else uncertainty_of(self._estimate.P)
