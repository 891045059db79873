"""One closed loop with plain numbers only: the form that compiles, and that runs as plain Python too.

It does what :func:`diffbot_sim.reference_loop.simulate` does, with the filter of :mod:`scalar_filter`; a test holds
the two equal.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.options import FilterConfig, FilterOptions, options_of
from diffbot_control.law.controller import ControllerConfig, new_memory, step
from diffbot_control.law.limits import limit_velocity
from diffbot_control.law.polar_coordinates import in_front
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import Twist, WheelSpeeds
from diffbot_core.uncertainty import Estimate, Uncertainty, largest_deviation
from diffbot_sim.compiled.peer_laws import OURS, new_peer_memory, peer_step
from diffbot_sim.compiled.scalar_filter import Track, new_track
from diffbot_sim.compiled.sensing import Robot, observe
from diffbot_sim.model.outcome import Criteria, Outcome, add_step, new_totals, outcome_of
from diffbot_sim.model.philox import WHEEL_BLOCK, NoiseKey, draw
from diffbot_sim.model.plant import PlantConfig, PlantState, plant_step
from diffbot_sim.model.sensors import SensorConfig, due, fix_at

TRUTH, RAW, EKF = 0, 1, 2
"""The controller's feedback: the true pose, the newest fix, or the filter's estimate."""
NO_LANDMARKS = np.empty((0, 2))
"""The map without landmarks."""


class Case(NamedTuple):
    """All that a run needs but its name (seed, run) and its start."""

    plant: PlantConfig
    sensors: SensorConfig
    controller: ControllerConfig
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
    peer: int = OURS
    """which law drives, see :mod:`peer_laws`; of ``controller`` a peer keeps the limits of the velocity"""


class Feedback(NamedTuple):
    """What is known of the robot."""

    track: Track | None
    """state of the filter; None without one"""
    pose: Pose
    """what the controller gets"""
    known: bool
    """False before there is one"""


def run_loop(case: Case, seed: int, run: int, start: Pose, history: Any) -> Outcome:
    """Do one run.

    Args:
        case: what all runs share.
        seed: of the campaign.
        run: number of the run.
        start: true pose at first, in map.
        history: (steps + 1, 8) array whose rows are filled, or (0, 8) for none.
    """
    t_s = case.plant.sampling_time
    criteria = Criteria(case.goal, case.xy_tolerance, case.yaw_tolerance, t_s, case.steps)
    rest = WheelSpeeds(0.0, 0.0)
    state = PlantState(start, Twist(0.0, 0.0), rest, rest, rest, Pose(0.0, 0.0, 0.0), 0)
    memory = new_memory()
    peer_memory = new_peer_memory()
    feedback = Feedback(_new_track(case.filter), start, False)
    totals = new_totals()
    for index in range(case.steps + 1):
        feedback = _observe(case, NoiseKey(seed, run, index), state, feedback)
        command = Twist(0.0, 0.0)
        if feedback.known and case.peer != OURS:
            peer_memory, requested = peer_step(case.peer, peer_memory, into_frame(feedback.pose, case.goal))
            command = limit_velocity(requested, case.controller.data_sheet)
        elif feedback.known:
            dt = t_s if index > 0 else 0.0
            uncertainty = _uncertainty(case, feedback)
            memory, command, report = step(memory, Estimate(feedback.pose, uncertainty), case.goal, dt, case.controller)
            if case.literal_rear and not in_front(report.alpha):
                command = Twist(-command.v, command.omega)
        if len(history) > 0:
            _record(history, index, state.pose, feedback, command)
        before = state.pose
        if index < case.steps:
            state = plant_step(state, command, draw(seed, run, index, WHEEL_BLOCK), case.plant)
        totals = add_step(totals, criteria, index, memory.switching.region, command, before, state.pose)
    return outcome_of(totals, criteria, memory.switching.switches, feedback.pose, feedback.known, state.pose)


def _uncertainty(case: Case, feedback: Feedback) -> Uncertainty:
    """Return the standard deviations of the estimate; a fix and the true pose come without any."""
    if case.feedback != EKF:
        return Uncertainty(0.0, 0.0)
    return _deviations(feedback.track)


def _deviations(track: Track | None) -> Uncertainty:
    if track is None:
        return Uncertainty(0.0, 0.0)
    P = track.belief.P
    return Uncertainty(largest_deviation(P.xx, P.xy, P.yy), math.sqrt(max(P.tt, 0.0)))


def _observe(case: Case, key: NoiseKey, state: PlantState, feedback: Feedback) -> Feedback:
    """Sense and filter."""
    if case.feedback == TRUTH:
        return Feedback(feedback.track, state.pose, True)
    if case.feedback == RAW:
        if due(key.step, case.sensors.fix_rate, case.plant.sampling_time):
            fix, lost = fix_at(key, state.pose, case.sensors)
            if not lost:
                return Feedback(feedback.track, fix, True)
        return feedback
    return _filtered(feedback.track, case.filter, case, key, state)


def _new_track(options: FilterOptions | None) -> Track | None:
    if options is None:
        return None
    return new_track(options)


def _filtered(
    track: Track | None, options: FilterOptions | None, case: Case, key: NoiseKey, state: PlantState
) -> Feedback:
    """Sense and filter; numba leaves out the branch behind an argument that is None by its type."""
    if track is None or options is None:
        return Feedback(track, state.pose, False)
    track = observe(track, key, state, Robot(case.plant, case.sensors, options, case.landmarks))
    return Feedback(track, track.belief.pose, track.initialised)


def _record(history: Any, index: int, pose: Pose, feedback: Feedback, command: Twist) -> None:
    row = history[index]
    row[0], row[1], row[2] = pose.x, pose.y, pose.theta
    row[3], row[4], row[5] = math.nan, math.nan, math.nan
    if feedback.known:
        row[3], row[4], row[5] = feedback.pose.x, feedback.pose.y, feedback.pose.theta
    row[6], row[7] = command.v, command.omega
