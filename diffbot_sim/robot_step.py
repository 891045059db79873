"""One step of a simulated robot: sense and filter, ask the law, move. Plain numbers and arrays only.

The functions run as plain Python in the reference loop. :mod:`jit` registers them with numba, and the batch engine
runs the same functions compiled. A law's step is made by :func:`make_step`, since compiled code calls a function by its
name.
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
from diffbot_sim.config import PlantConfig, SensorConfig, check_detector
from diffbot_sim.fusion import Recent, Robot, arriving_pose, estimate, forget, pose_at, record_step
from diffbot_sim.outcome import Criteria, LawState, Outcome, add_step, new_totals, outcome_of
from diffbot_sim.plant import PlantState, delayed_command, new_plant, plant_step
from diffbot_sim.sensors import NO_ERRORS, FixErrors, is_pose_due, measured_pose, pose_delay

TRUTH, RAW, EKF = "truth", "raw", "ekf"
FEEDBACKS = (TRUTH, RAW, EKF)
"""The controller's feedback: the true pose, the newest fix as in the paper's simulations, or the filter's estimate."""
TRUTH_CODE, RAW_CODE, EKF_CODE = range(3)
"""Indices of FEEDBACKS, for compiled code."""


class Feedback(NamedTuple):
    """What is known of the robot."""

    pose: Pose
    """what the controller gets"""
    uncertainty: Uncertainty
    """of the estimate; a fix and the true pose come without any"""
    known: bool
    """False before there is one"""


class Body(NamedTuple):
    """A robot between two steps, but for its :class:`Recent` arrays."""

    state: PlantState
    errors: FixErrors
    """of the newest fix"""
    feedback: Feedback


def start(recent: Recent, pose: Pose) -> Body:
    """Put a robot at rest at ``pose`` in map, and forget the steps before."""
    forget(recent)
    return Body(new_plant(pose), NO_ERRORS, Feedback(pose, CERTAIN, False))


def advance(body: Body, commands: Any, command: Twist, noise: Any, plant: PlantConfig) -> Body:
    """Move a robot for one sampling time under a requested command.

    Args:
        body: before the step.
        commands: those of :class:`Recent`.
        command: requested twist.
        noise: (purposes, 4) numbers in [0, 1) of this step.
        plant: configuration.
    """
    state = body.state
    arrived = delayed_command(commands, state.step, command, plant.command_delay, plant.sampling_time)
    return Body(plant_step(state, arrived, noise, plant), body.errors, body.feedback)


def sense_truth(body: Body, recent: Recent, noise: Any, sensors: SensorConfig, sampling_time: float) -> Body:
    """Give the controller the true pose."""
    return Body(body.state, body.errors, Feedback(body.state.pose, CERTAIN, True))


def sense_fix(body: Body, recent: Recent, noise: Any, sensors: SensorConfig, sampling_time: float) -> Body:
    """Measure at the present step, and give the controller the pose that arrives."""
    state, feedback = body.state, body.feedback
    if pose_delay(sensors) <= 0.0:
        if not is_pose_due(state.step, sensors, sampling_time):
            return body
        fix = measured_pose(state.pose, body.errors, noise, sensors)
        return Body(state, fix.errors, feedback if fix.lost else Feedback(fix.pose, CERTAIN, True))
    errors = record_step(recent, state, body.errors, noise)
    arrived = arriving_pose(recent, state.step)
    if arrived >= 0:
        feedback = Feedback(pose_at(recent, arrived), CERTAIN, True)
    return Body(state, errors, feedback)


def sense_estimate(body: Body, recent: Recent, noise: Any, sensors: SensorConfig, sampling_time: float) -> Body:
    """Measure at the present step, fuse what arrives, and give the controller the filter's estimate."""
    state, feedback = body.state, body.feedback
    errors = record_step(recent, state, body.errors, noise)
    known, pose, uncertainty = estimate(recent, state.step)
    if known:
        feedback = Feedback(pose, uncertainty, True)
    return Body(state, errors, feedback)


SENSES = sense_truth, sense_fix, sense_estimate
"""How a robot gets each of FEEDBACKS. Compiled code contains only the one that it needs."""


class Case(NamedTuple):
    """All that a run needs but its name (seed, run) and its start."""

    robot: Robot
    controller: Any
    """configuration of the law, an instance of its Config"""
    goal: Pose
    feedback: int
    """one of the codes of FEEDBACKS"""
    literal_rear: bool
    """use the sign that the paper prints for the velocity in the rear sector"""
    steps: int
    xy_tolerance: float
    """[m] for the settling time"""
    yaw_tolerance: float
    """[rad]"""
    history_length: float = LocalizationConfig().history_length
    """[s] how late a measurement may come at most; longer delays are refused"""


def make_step(law: type[Law], feedback: int) -> Callable[..., tuple[Body, Any, Twist, LawState]]:
    """Return the function that advances a robot under a law by one period, with one of the codes of FEEDBACKS."""
    law_step, sense = law.step, SENSES[feedback]

    def robot_step(
        body: Body, memory: Any, recent: Recent, noise: Any, case: Case
    ) -> tuple[Body, Any, Twist, LawState]:
        """Sense, filter, ask the law and move by one period.

        Args:
            body: before the step.
            memory: of the law.
            recent: arrays of the robot.
            noise: (purposes, 4) numbers in [0, 1) of this step.
            case: what all runs share.

        Returns:
            Robot and memory after the step, the command, and what the law reports.
        """
        plant, sensors, commands = case.robot.plant, case.robot.sensors, recent.commands
        body = sense(body, recent, noise, sensors, plant.sampling_time)
        command, answer, feedback = Twist(0.0, 0.0), LawState(OMEGA_G, False), body.feedback
        if feedback.known:
            dt = plant.sampling_time if body.state.step > 0 else 0.0
            found = Estimate(feedback.pose, feedback.uncertainty)
            observation = Observation(found, dt, plant.sampling_time, CONTACT_UNKNOWN)
            memory, command, report = law_step(memory, observation, case.goal, case.controller)
            answer = LawState(report.region, memory.reached)
            if case.literal_rear and not in_front(report.alpha):
                command = Twist(-command.v, command.omega)
        if body.state.step < case.steps:
            body = advance(body, commands, command, noise, plant)
        return body, memory, command, answer

    return robot_step


HISTORY_COLUMNS = (
    *("x", "y", "theta", "seen_x", "seen_y", "seen_theta", "v", "omega", "sigma", "sigma_theta", "region", "reached"),
)
"""True pose, pose given to the controller (seen_*), command, standard deviations of position [m] and heading [rad] that
were given with that pose (0 for a feedback without them), region, 1 once the law reports the goal as reached."""


def make_loop(law: type[Law], feedback: int) -> Callable[[Case, Recent, Any, Pose, Any], Outcome]:
    """Return the function that does one run under a law, with one of the codes of FEEDBACKS.

    It compiles if the law's functions do.
    """
    robot_step, new_memory = make_step(law, feedback), law.new_memory

    def run_loop(case: Case, recent: Recent, noise: Any, begin: Pose, history: Any) -> Outcome:
        """Do one run.

        Args:
            case: what all runs share; ``controller`` is of the law's Config.
            recent: from :func:`new_recent`.
            noise: (purposes, steps + 1, 4) numbers in [0, 1).
            begin: true pose at first, in map.
            history: (steps + 1, 12) array whose rows are filled, see HISTORY_COLUMNS, or (0, 12) for none.
        """
        criteria = Criteria(
            case.goal, case.xy_tolerance, case.yaw_tolerance, case.robot.plant.sampling_time, case.steps
        )
        body, memory, totals = start(recent, begin), new_memory(case.controller), new_totals()
        for index in range(case.steps + 1):
            before = body.state.pose
            body, memory, command, answer = robot_step(body, memory, recent, noise[:, index], case)
            if len(history) > 0:
                _record(history[index], before, body.feedback, command, answer)
            totals = add_step(totals, criteria, index, answer, command, before, body.state.pose)
        return outcome_of(totals, criteria, body.feedback.pose, body.feedback.known, body.state.pose)

    return run_loop


def _record(row: Any, pose: Pose, feedback: Feedback, command: Twist, answer: LawState) -> None:
    row[:] = math.nan
    row[0], row[1], row[2] = pose
    if feedback.known:
        row[3], row[4], row[5] = feedback.pose
        row[8], row[9] = feedback.uncertainty
    row[6], row[7] = command
    row[10], row[11] = answer.region, answer.reached


def check_robot(robot: Robot, history_length: float) -> None:
    """Refuse what a loop of one filter does not support; ``history_length`` [s] is how late a measurement may come.

    Raises:
        InvalidValueError: for measurements later than the history; for a filter with a gyro on a robot without one; see
            :func:`config.check_detector`.
    """
    sensors = robot.sensors
    check_detector(sensors)
    if robot.filter.variances[BIAS - WHEELS] > 0.0 and sensors.gyro_rate == 0.0:
        raise InvalidValueError("use_gyro", True, "false while gyro_rate is 0")
    if pose_delay(sensors) > history_length:
        name = "detection_delay" if sensors.detector.detection_rate > 0.0 else "fix_delay"
        raise InvalidValueError(
            name, pose_delay(sensors), f"<= {history_length:g} s, the length of the filter's history"
        )
