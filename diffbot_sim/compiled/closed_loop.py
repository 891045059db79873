"""One closed loop with plain numbers only: the form that compiles, and that runs as plain Python too.

It does what :func:`diffbot_sim.reference_loop.simulate` does, with the filter of :mod:`scalar_filter`; a test holds
the two equal. The loop of a law is made by :func:`make_loop`, since compiled code calls a function by its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.options import FilterConfig, FilterOptions, options_of
from diffbot_control.goals.protocol import Law
from diffbot_control.law.controller import SwitchingLaw
from diffbot_control.law.polar_coordinates import in_front
from diffbot_control.law.regions import OMEGA_G
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty, largest_deviation
from diffbot_sim.compiled.late_fusion import (
    LateRecord,
    Sensed,
    arrived_fix,
    late_steps,
    new_sensed,
    record_step,
    sense,
)
from diffbot_sim.compiled.scalar_filter import Track
from diffbot_sim.compiled.sensing import Robot
from diffbot_sim.model.actuators import command_rows, delayed_command
from diffbot_sim.model.outcome import Criteria, LawState, Outcome, add_step, new_totals, outcome_of
from diffbot_sim.model.philox import NoiseKey
from diffbot_sim.model.plant import PlantConfig, PlantState, new_plant, plant_step_at
from diffbot_sim.model.sensors import SensorConfig, due, fix_at

TRUTH, RAW, EKF = 0, 1, 2
"""The controller's feedback: the true pose, the newest fix, or the filter's estimate."""
NO_LANDMARKS = np.empty((0, 2))
"""The map without landmarks."""


class Case(NamedTuple):
    """All that a run needs but its name (seed, run) and its start."""

    plant: PlantConfig
    sensors: SensorConfig
    controller: Any
    """configuration of the law, an instance of its Config"""
    goal: Pose
    feedback: int
    literal_rear: bool
    """use the sign that the paper prints for the velocity in the rear sector"""
    steps: int
    xy_tolerance: float
    """[m] for the settling time"""
    yaw_tolerance: float
    """[rad]"""
    filter: FilterOptions | None = options_of(FilterConfig())
    """None for a feedback without a filter: the compiler then leaves the filter out, see :func:`_filtered`"""
    landmarks: Any = NO_LANDMARKS
    """(n, 2) array of their x, y [m]"""
    history_length: float = LocalizationConfig().history_length
    """[s] how late a measurement may come at most; longer delays are refused"""
    late_steps: int | None = None
    """the longest delay in steps; :func:`prepared` sets it, None if no measurement is late"""


class Feedback(NamedTuple):
    """What is known of the robot."""

    sensed: Sensed
    """state of the sensors and of the filter"""
    pose: Pose
    """what the controller gets"""
    known: bool
    """False before there is one"""


def prepared(case: Case) -> Case:
    """Return the case as :func:`run_loop` takes it: None stands for the parts that it does not need."""
    late = None if case.feedback == TRUTH else late_steps(case.sensors, case.plant.sampling_time)
    return case._replace(filter=case.filter if case.feedback == EKF else None, late_steps=late)


def make_loop(law: Law) -> Callable[[Case, int, int, Pose, Any], Outcome]:
    """Return the function that does one run under a law; it compiles if the law's functions do."""
    new_memory, step = law.new_memory, law.step

    def run_loop(case: Case, seed: int, run: int, start: Pose, history: Any) -> Outcome:
        """Do one run.

        Args:
            case: what all runs share, from :func:`prepared`; ``controller`` is of the law's Config.
            seed: of the campaign.
            run: number of the run.
            start: true pose at first, in map.
            history: (steps + 1, 9) array whose rows are filled, or (0, 9) for none.
        """
        t_s, delay = case.plant.sampling_time, case.plant.actuators.command_delay
        criteria = Criteria(case.goal, case.xy_tolerance, case.yaw_tolerance, t_s, case.steps)
        commands = np.zeros((command_rows(delay, t_s), 2))
        state, memory, totals = new_plant(start), new_memory(case.controller), new_totals()
        answer = LawState(OMEGA_G, False)
        feedback, robot = Feedback(new_sensed(case.filter, case.late_steps), start, False), _robot_of(case)
        for index in range(case.steps + 1):
            key = NoiseKey(seed, run, index)
            feedback = next_feedback(case.feedback, robot, key, state, feedback)
            command = Twist(0.0, 0.0)
            if feedback.known:
                dt = t_s if index > 0 else 0.0
                estimate = Estimate(feedback.pose, _uncertainty(case.feedback, feedback.sensed.track))
                memory, command, report = step(memory, estimate, case.goal, dt, case.controller)
                answer = LawState(report.region, memory.reached)
                if case.literal_rear and not in_front(report.alpha):
                    command = Twist(-command.v, command.omega)
            if len(history) > 0:
                _record(history, index, state.pose, feedback, command, case.feedback)
            before = state.pose
            if index < case.steps:
                state = plant_step_at(key, state, delayed_command(commands, index, command, delay, t_s), case.plant)
            totals = add_step(totals, criteria, index, answer, command, before, state.pose)
        return outcome_of(totals, criteria, feedback.pose, feedback.known, state.pose)

    return run_loop


run_loop = make_loop(SwitchingLaw)
"""One run under this project's law."""


def _robot_of(case: Case) -> Robot:
    """Return what the filter depends on; with the law's Config in its type, it would be compiled again for each law."""
    return Robot(case.plant, case.sensors, case.filter, case.landmarks)


def _uncertainty(kind: int, track: Track | None) -> Uncertainty:
    """Return the standard deviations of the estimate; a fix and the true pose come without any."""
    if track is None or kind != EKF:
        return Uncertainty(0.0, 0.0)
    P = track.belief.P
    return Uncertainty(largest_deviation(P.xx, P.xy, P.yy), math.sqrt(max(P.tt, 0.0)))


def next_feedback(kind: int, robot: Robot, key: NoiseKey, state: PlantState, feedback: Feedback) -> Feedback:
    """Sense, filter if the controller gets the estimate, and return what it gets."""
    if kind == TRUTH:
        return Feedback(feedback.sensed, state.pose, True)
    if kind == RAW:
        return _newest_fix(feedback.sensed.record, robot, key, state, feedback)
    return _filtered(feedback.sensed.track, robot, key, state, feedback.sensed)


def _newest_fix(
    record: LateRecord | None, robot: Robot, key: NoiseKey, state: PlantState, feedback: Feedback
) -> Feedback:
    """Return the fix that arrived last; numba leaves out the branch behind an argument that is None by its type."""
    sensors, sensed, t_s = robot.sensors, feedback.sensed, robot.plant.sampling_time
    if record is not None:
        errors = record_step(record, sensed.errors, key, state, t_s, sensors)
        pose, known = arrived_fix(record, key.step, feedback.pose, feedback.known)
        return Feedback(Sensed(sensed.track, errors, sensed.record), pose, known)
    if not due(key.step, sensors.fix_rate, t_s):
        return feedback
    fix = fix_at(key, state.pose, sensed.errors, sensors)
    after = Sensed(sensed.track, fix.errors, sensed.record)
    if fix.lost:
        return Feedback(after, feedback.pose, feedback.known)
    return Feedback(after, fix.pose, True)


def _filtered(track: Track | None, robot: Robot, key: NoiseKey, state: PlantState, sensed: Sensed) -> Feedback:
    """Sense and filter; numba leaves out the branch behind an argument that is None by its type."""
    if track is None:
        return Feedback(sensed, state.pose, False)
    sensed = sense(sensed, key, state, robot)
    return _feedback_of(sensed, sensed.track)


def _feedback_of(sensed: Sensed, track: Any) -> Feedback:
    return Feedback(sensed, track.belief.pose, track.initialised)


def _record(history: Any, index: int, pose: Pose, feedback: Feedback, command: Twist, kind: int) -> None:
    row = history[index]
    row[0], row[1], row[2] = pose.x, pose.y, pose.theta
    row[3], row[4], row[5], row[8] = math.nan, math.nan, math.nan, math.nan
    if feedback.known:
        row[3], row[4], row[5] = feedback.pose.x, feedback.pose.y, feedback.pose.theta
        row[8] = _uncertainty(kind, feedback.sensed.track).xy
    row[6], row[7] = command.v, command.omega
