"""One step of a simulated robot: measure, filter, run the law, move.

The functions use plain numbers and arrays only. The reference loop runs them as plain Python, and the batch engine runs
the same functions compiled by :mod:`jit`. Compiled code calls functions by name, so :func:`make_step` and
:func:`make_loop` build one function for each law.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from diffbot_control.filter.config import LocalizationConfig
from diffbot_control.filter.models import BIAS, WHEELS
from diffbot_control.law.law import CONTACT_UNKNOWN, Law, Observation
from diffbot_control.law.regions import OMEGA_G
from diffbot_control.law.steering import in_front
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty
from diffbot_sim.config import PlantConfig, SensorConfig, dock_pose
from diffbot_sim.fusion import RunBuffers, SimulatedRobot, arriving_pose, clear, estimate, pose_at, record_step
from diffbot_sim.outcome import Criteria, LawState, Outcome, add_step, new_totals, outcome_of
from diffbot_sim.plant import PlantState, delayed_command, new_plant, plant_step
from diffbot_sim.sensors import NO_ERRORS, FixErrors, is_pose_due, measured_pose, pose_delay

TRUTH, RAW, EKF = "truth", "raw", "ekf"
FEEDBACKS = (TRUTH, RAW, EKF)
"""Pose that the controller receives: the true pose, the newest fix (as in the paper), or the filter's estimate."""


class Feedback(NamedTuple):
    """Pose that the controller receives."""

    pose: Pose
    uncertainty: Uncertainty
    """of the filter's estimate; CERTAIN for the true pose and for fixes"""
    known: bool
    """False until the first pose arrives"""


class RobotState(NamedTuple):
    """State of a simulated robot between two steps, except for its :class:`RunBuffers`."""

    plant: PlantState
    fix_errors: FixErrors
    """errors of the newest fix"""
    feedback: Feedback


def start(buffers: RunBuffers, pose: Pose) -> RobotState:
    """Clear the buffers and return the state of a robot at rest at ``pose`` in map."""
    clear(buffers)
    return RobotState(new_plant(pose), NO_ERRORS, Feedback(pose, CERTAIN, False))


def advance(state: RobotState, commands: Any, command: Twist, noise: Any, config: PlantConfig) -> RobotState:
    """Move a robot for one sampling time.

    Args:
        state: state before the step.
        commands: ring buffer of :class:`RunBuffers`.
        command: requested twist.
        noise: (purposes, 4) numbers in [0, 1) of this step.
        config: configuration of the plant.
    """
    arrived = delayed_command(commands, state.plant.step, command, config.command_delay, config.sampling_time)
    return RobotState(plant_step(state.plant, arrived, noise, config), state.fix_errors, state.feedback)


def sense_truth(
    state: RobotState, buffers: RunBuffers, noise: Any, sensors: SensorConfig, sampling_time: float
) -> RobotState:
    """Set the feedback to the true pose."""
    return RobotState(state.plant, state.fix_errors, Feedback(state.plant.pose, CERTAIN, True))


def sense_fix(
    state: RobotState, buffers: RunBuffers, noise: Any, sensors: SensorConfig, sampling_time: float
) -> RobotState:
    """Measure, and set the feedback to the fix that arrives at the present step, if any."""
    plant, feedback = state.plant, state.feedback
    if pose_delay(sensors) <= 0.0:
        if not is_pose_due(plant.step, sensors, sampling_time):
            return state
        fix = measured_pose(plant.pose, state.fix_errors, noise, sensors)
        return RobotState(plant, fix.errors, feedback if fix.lost else Feedback(fix.pose, CERTAIN, True))
    errors = record_step(buffers, plant, state.fix_errors, noise)
    arrived = arriving_pose(buffers, plant.step)
    if arrived >= 0:
        feedback = Feedback(pose_at(buffers, arrived), CERTAIN, True)
    return RobotState(plant, errors, feedback)


def sense_estimate(
    state: RobotState, buffers: RunBuffers, noise: Any, sensors: SensorConfig, sampling_time: float
) -> RobotState:
    """Measure, fuse the measurements that arrive, and set the feedback to the filter's estimate."""
    plant, feedback = state.plant, state.feedback
    errors = record_step(buffers, plant, state.fix_errors, noise)
    known, pose, uncertainty = estimate(buffers, plant.step)
    if known:
        feedback = Feedback(pose, uncertainty, True)
    return RobotState(plant, errors, feedback)


SENSES = sense_truth, sense_fix, sense_estimate
"""Functions that set the feedback, in the order of FEEDBACKS. Compiled code contains only one of them."""


class Case(NamedTuple):
    """Everything that the runs of a batch share. A run adds its seed, its number and its start."""

    robot: SimulatedRobot
    controller: Any
    """configuration of the law, an instance of its Config"""
    goal: Pose
    feedback: int
    """index of FEEDBACKS"""
    literal_rear: bool
    """use the sign that the paper prints for the velocity in the rear sector"""
    steps: int
    xy_tolerance: float
    """[m] for the settling time"""
    yaw_tolerance: float
    """[rad] for the settling time"""
    history_length: float = LocalizationConfig().history_length
    """[s] largest delay of a measurement"""


def make_step(law: type[Law], feedback: int) -> Callable[..., tuple[RobotState, Any, Twist, LawState]]:
    """Return the function that advances a robot under a law by one period; ``feedback`` is an index of FEEDBACKS."""
    law_step, sense = law.step, SENSES[feedback]

    def robot_step(
        state: RobotState, memory: Any, buffers: RunBuffers, noise: Any, case: Case
    ) -> tuple[RobotState, Any, Twist, LawState]:
        """Measure, filter, run the law, and move for one period. The robot does not move in the last step.

        Args:
            state: state before the step.
            memory: memory of the law.
            buffers: buffers of the run.
            noise: (purposes, 4) numbers in [0, 1) of this step.
            case: the case of the run.

        Returns:
            State and memory after the step, the command, and what the law reports.
        """
        plant, sensors = case.robot.plant, case.robot.sensors
        state = sense(state, buffers, noise, sensors, plant.sampling_time)
        command, answer, feedback = Twist(0.0, 0.0), LawState(OMEGA_G, False), state.feedback
        if feedback.known:
            dt = plant.sampling_time if state.plant.step > 0 else 0.0
            found = Estimate(feedback.pose, feedback.uncertainty)
            observation = Observation(found, dt, plant.sampling_time, CONTACT_UNKNOWN)
            memory, command, report = law_step(memory, observation, case.goal, case.controller)
            answer = LawState(report.region, memory.reached)
            if case.literal_rear and not in_front(report.alpha):
                command = Twist(-command.v, command.omega)
        if state.plant.step < case.steps:
            state = advance(state, buffers.commands, command, noise, plant)
        return state, memory, command, answer

    return robot_step


HISTORY_COLUMNS = (
    *("x", "y", "theta", "feedback_x", "feedback_y", "feedback_theta", "v", "omega"),
    *("sigma", "sigma_theta", "region", "reached"),
)
"""True pose; pose that the controller receives; command; standard deviations of that pose's position [m] and heading
[rad], 0 for feedback other than the filter's; region; 1 once the law reports the goal as reached."""


def make_loop(law: type[Law], feedback: int) -> Callable[[Case, RunBuffers, Any, Pose, Any], Outcome]:
    """Return the function that simulates one run under a law; ``feedback`` is an index of FEEDBACKS.

    Numba can compile the function if it can compile the functions of the law.
    """
    robot_step, new_memory = make_step(law, feedback), law.new_memory

    def run_loop(case: Case, buffers: RunBuffers, noise: Any, begin: Pose, history: Any) -> Outcome:
        """Simulate one run.

        Args:
            case: the case of the run; ``controller`` is an instance of the law's Config.
            buffers: from :func:`new_buffers`.
            noise: (purposes, steps + 1, 4) numbers in [0, 1).
            begin: true start pose in map.
            history: (steps + 1, 12) array to fill, columns as HISTORY_COLUMNS; (0, 12) to record nothing.
        """
        criteria = Criteria(
            case.goal, case.xy_tolerance, case.yaw_tolerance, case.robot.plant.sampling_time, case.steps
        )
        state, memory, totals = start(buffers, begin), new_memory(case.controller), new_totals()
        for index in range(case.steps + 1):
            before = state.plant.pose
            state, memory, command, answer = robot_step(state, memory, buffers, noise[:, index], case)
            if len(history) > 0:
                _record(history[index], before, state.feedback, command, answer)
            totals = add_step(totals, criteria, index, answer, command, before, state.plant.pose)
        return outcome_of(totals, criteria, state.feedback.pose, state.feedback.known, state.plant.pose)

    return run_loop


def _record(row: Any, pose: Pose, feedback: Feedback, command: Twist, answer: LawState) -> None:
    row[:] = math.nan
    row[0], row[1], row[2] = pose
    if feedback.known:
        row[3], row[4], row[5] = feedback.pose
        row[8], row[9] = feedback.uncertainty
    row[6], row[7] = command
    row[10], row[11] = answer.region, answer.reached


def check_robot(robot: SimulatedRobot, history_length: float) -> None:
    """Refuse sensors that the loop does not support; ``history_length`` [s] is the largest delay of a measurement.

    Raises:
        InvalidValueError: for a detector together with fixes, since the loop has one filter; for a dock that is not at
            the origin, since the map of a filter with a detector is the frame of the dock; for a filter that uses a
            gyro on a robot without a gyro; for poses that are delayed by more than the history.
    """
    sensors, detector = robot.sensors, robot.sensors.detector
    if detector.detection_rate > 0.0:
        if sensors.fix_rate > 0.0:
            bound = "0 with a detection_rate, since this simulation has one filter"
            raise InvalidValueError("fix_rate", sensors.fix_rate, bound)
        if dock_pose(detector) != (0.0, 0.0, 0.0):
            raise InvalidValueError("dock_x, dock_y, dock_yaw", tuple(dock_pose(detector)), "0 in this simulation")
    if robot.filter.variances[BIAS - WHEELS] > 0.0 and sensors.gyro_rate == 0.0:
        raise InvalidValueError("use_gyro", True, "false while gyro_rate is 0")
    if pose_delay(sensors) > history_length:
        name = "detection_delay" if detector.detection_rate > 0.0 else "fix_delay"
        raise InvalidValueError(
            name, pose_delay(sensors), f"<= {history_length:g} s, the length of the filter's history"
        )
