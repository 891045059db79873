"""One closed loop with plain numbers only: the form that compiles, and that runs as plain Python too.

It does what :func:`diffbot_sim.reference_loop.simulate` does, with the filter of :mod:`gated_filter`; a test holds
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
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty, largest_deviation
from diffbot_sim.compiled.ekf import pose_of
from diffbot_sim.compiled.gated_filter import reported_belief, reset_arrays
from diffbot_sim.compiled.late_fusion import (
    WITH_WHEELS,
    Buffers,
    Example,
    LateRecord,
    Sensed,
    arrived_fix,
    example_for,
    late_steps,
    new_buffers,
    new_sensed,
    record_step,
    reset_record,
    sense,
)
from diffbot_sim.compiled.sensing import Robot
from diffbot_sim.model.actuators import command_rows, delayed_command
from diffbot_sim.model.outcome import Criteria, LawState, Outcome, add_step, new_totals, outcome_of
from diffbot_sim.model.philox import NoiseKey
from diffbot_sim.model.plant import PlantConfig, PlantState, new_plant, plant_step_at
from diffbot_sim.model.sensors import SensorConfig, is_pose_due, measured_pose_at

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
    filter: FilterOptions = options_of(FilterConfig())
    landmarks: Any = NO_LANDMARKS
    """(n, 2) array of their x, y [m]"""
    history_length: float = LocalizationConfig().history_length
    """[s] how late a measurement may come at most; longer delays are refused"""
    late_steps: int = 0
    """the longest delay in steps; :func:`prepared` sets it, 0 if no measurement is late"""
    example: Example = WITH_WHEELS
    """of the arrays that a run works with; :func:`prepared` sets it"""


class Feedback(NamedTuple):
    """What is known of the robot."""

    sensed: Sensed
    pose: Pose
    """what the controller gets"""
    uncertainty: Uncertainty
    """of the estimate; a fix and the true pose come without any"""
    known: bool
    """False before there is one"""


def prepared(case: Case) -> Case:
    """Return the case as :func:`run_loop` takes it."""
    late = 0 if case.feedback == TRUTH else late_steps(case.sensors, case.plant.sampling_time)
    return case._replace(late_steps=late, example=example_for(case.landmarks, case.filter))


def buffers_for(case: Case) -> Buffers:
    """Return what :func:`run_loop` works with under a :func:`prepared` case, one run after the other."""
    return new_buffers(case.late_steps, len(case.landmarks), case.example)


def make_loop(law: Law) -> Callable[[Case, Buffers, int, int, Pose, Any], Outcome]:
    """Return the function that does one run under a law; it compiles if the law's functions do."""
    new_memory, step = law.new_memory, law.step

    def run_loop(case: Case, buffers: Buffers, seed: int, run: int, start: Pose, history: Any) -> Outcome:
        """Do one run.

        Args:
            case: what all runs share, from :func:`prepared`; ``controller`` is of the law's Config.
            buffers: from :func:`buffers_for`.
            seed: of the campaign.
            run: number of the run.
            start: true pose at first, in map.
            history: (steps + 1, 10) array whose rows are filled, see batch.HISTORY_COLUMNS, or (0, 10) for none.
        """
        # Records, of which compiled code counts no references as it does of arrays.
        arrays, record = buffers.filter[0], LateRecord(buffers.steps, buffers.tracks, buffers.stamps[0], buffers.seen)
        reset_arrays(arrays, case.filter)
        reset_record(record)
        t_s, delay = case.plant.sampling_time, case.plant.actuators.command_delay
        criteria = Criteria(case.goal, case.xy_tolerance, case.yaw_tolerance, t_s, case.steps)
        commands = np.zeros((command_rows(delay, t_s), 2))
        state, memory, totals = new_plant(start), new_memory(case.controller), new_totals()
        answer = LawState(OMEGA_G, False)
        feedback, robot = Feedback(new_sensed(), start, CERTAIN, False), robot_of(case)
        for index in range(case.steps + 1):
            key = NoiseKey(seed, run, index)
            feedback = next_feedback(case.feedback, robot, key, state, feedback, arrays, record)
            command = Twist(0.0, 0.0)
            if feedback.known:
                dt = t_s if index > 0 else 0.0
                found = Estimate(feedback.pose, feedback.uncertainty)
                memory, command, report = step(memory, found, case.goal, dt, case.controller)
                answer = LawState(report.region, memory.reached)
                if case.literal_rear and not in_front(report.alpha):
                    command = Twist(-command.v, command.omega)
            if len(history) > 0:
                _record(history, index, state.pose, feedback, command)
            before = state.pose
            if index < case.steps:
                state = plant_step_at(key, state, delayed_command(commands, index, command, delay, t_s), case.plant)
            totals = add_step(totals, criteria, index, answer, command, before, state.pose)
        return outcome_of(totals, criteria, feedback.pose, feedback.known, state.pose)

    return run_loop


run_loop = make_loop(SwitchingLaw)
"""One run under this project's law."""


def robot_of(case: Case) -> Robot:
    """Return what the filter depends on; with the law's Config in its type, it would be compiled again for each law."""
    return Robot(case.plant, case.sensors, case.filter, case.landmarks)


def next_feedback(
    kind: int, robot: Robot, key: NoiseKey, state: PlantState, feedback: Feedback, arrays: Any, record: LateRecord
) -> Feedback:
    """Sense, filter if the controller gets the estimate, and return what it gets."""
    if kind == TRUTH:
        return Feedback(feedback.sensed, state.pose, CERTAIN, True)
    if kind == RAW:
        return _newest_fix(robot, key, state, feedback, record)
    sensed = sense(feedback.sensed, arrays, record, key, state, robot)
    reported = reported_belief(arrays, robot.filter)
    P = reported["P"]
    uncertainty = Uncertainty(largest_deviation(P[0, 0], P[0, 1], P[1, 1]), math.sqrt(max(P[2, 2], 0.0)))
    return Feedback(sensed, pose_of(reported), uncertainty, sensed.track.initialised)


def _newest_fix(robot: Robot, key: NoiseKey, state: PlantState, feedback: Feedback, record: LateRecord) -> Feedback:
    """Return the fix that arrived last."""
    sensors, sensed, t_s = robot.sensors, feedback.sensed, robot.plant.sampling_time
    if len(record.steps) > 0:
        errors = record_step(record, sensed.errors, key, state, t_s, sensors)
        pose, known = arrived_fix(record, key.step, feedback.pose, feedback.known)
        return Feedback(Sensed(sensed.track, errors), pose, CERTAIN, known)
    if not is_pose_due(key.step, sensors, t_s):
        return feedback
    fix = measured_pose_at(key, state.pose, sensed.errors, sensors)
    after = Sensed(sensed.track, fix.errors)
    if fix.lost:
        return Feedback(after, feedback.pose, CERTAIN, feedback.known)
    return Feedback(after, fix.pose, CERTAIN, True)


def _record(history: Any, index: int, pose: Pose, feedback: Feedback, command: Twist) -> None:
    row = history[index]
    row[0], row[1], row[2] = pose.x, pose.y, pose.theta
    row[3], row[4], row[5], row[8], row[9] = math.nan, math.nan, math.nan, math.nan, math.nan
    if feedback.known:
        row[3], row[4], row[5] = feedback.pose.x, feedback.pose.y, feedback.pose.theta
        row[8], row[9] = feedback.uncertainty.xy, feedback.uncertainty.theta
    row[6], row[7] = command.v, command.omega
