"""One closed loop with plain numbers only: the form that compiles, and that runs as plain Python too.

It does what :func:`diffbot_sim.reference_loop.simulate` does, with the filter of :mod:`scalar_filter`; a test
holds them together.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.options import FilterConfig, FilterOptions, options_of
from diffbot_control.law.controller import ControllerConfig, new_memory, step
from diffbot_control.law.limits import limit_velocity
from diffbot_control.law.polar_coordinates import in_front
from diffbot_control.law.regions import OMEGA_L
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import Twist, WheelSpeeds
from diffbot_core.uncertainty import Uncertainty, largest_deviation
from diffbot_sim.compiled.peer_laws import OURS, new_peer_memory, peer_step
from diffbot_sim.compiled.scalar_filter import Track, new_track
from diffbot_sim.compiled.sensing import NoiseKey, Robot, fix_at, observe
from diffbot_sim.model.philox import WHEEL_BLOCK, draw
from diffbot_sim.model.plant import PlantConfig, PlantState, plant_step
from diffbot_sim.model.sensors import SensorConfig, due

TRUTH, RAW, EKF = 0, 1, 2
"""What the controller sees: the true pose, the newest fix, or the filter's estimate."""
NO_LANDMARKS = np.empty((0, 2))
"""The map of a robot that sees none."""


class Case(NamedTuple):
    """All that a run needs but its name (seed, run) and its start."""

    plant: PlantConfig
    sensors: SensorConfig
    controller: ControllerConfig
    goal: Pose
    feedback: int
    literal_rear: bool
    """The rear sector's velocity with the sign that the paper prints"""
    steps: int
    xy_tolerance: float
    """[m] for the settling time"""
    yaw_tolerance: float
    """[rad]"""
    filter: FilterOptions | None = options_of(FilterConfig())
    """None for a feedback without a filter: the compiler leaves out what is behind it, see :func:`_filtered`"""
    landmarks: Any = NO_LANDMARKS
    """(n, 2) array of their x, y [m]"""
    peer: int = OURS
    """which law drives, see :mod:`peer_laws`; of ``controller`` a peer keeps the limits of the velocity"""


class Outcome(NamedTuple):
    """What is kept of a run."""

    x: float
    """[m] true end pose in the goal's frame"""
    y: float
    theta: float
    settling_time: float
    """[s] until the last entry into the tolerances; nan if the run ends outside"""
    path_length: float
    """[m]"""
    effort: float
    """integral of v^2 + omega^2 over time [m^2/s + rad^2/s]"""
    switches: float
    """changes of region"""
    local_time: float
    """[s] when Omega_L was entered first; nan if never"""
    estimation_error: float
    """[m] distance of what the controller saw last from the truth"""


class View(NamedTuple):
    """What is known of the robot."""

    track: Track | None
    seen: Pose
    """what the controller gets"""
    has_seen: bool


class RunTotals(NamedTuple):
    """What is summed up along a run."""

    last_outside: int
    """last step outside the tolerances, -1 for none"""
    path_length: float
    effort: float
    local_time: float


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
    rest = WheelSpeeds(0.0, 0.0)
    state = PlantState(start, Twist(0.0, 0.0), rest, rest, rest, Pose(0.0, 0.0, 0.0), 0)
    memory = new_memory()
    peer_memory = new_peer_memory()
    view = View(_begun(case.filter), start, False)
    totals = RunTotals(-1, 0.0, 0.0, math.nan)
    for index in range(case.steps + 1):
        view = _observe(case, seed, run, index, state, view)
        command = Twist(0.0, 0.0)
        if view.has_seen and case.peer != OURS:
            peer_memory, wanted = peer_step(case.peer, peer_memory, into_frame(view.seen, case.goal))
            command = limit_velocity(wanted, case.controller.limits, case.controller.wheels)
        elif view.has_seen:
            dt = t_s if index > 0 else 0.0
            memory, command, report = step(memory, view.seen, case.goal, dt, case.controller, _uncertainty(case, view))
            if case.literal_rear and not in_front(report.alpha):
                command = Twist(-command.v, command.omega)
        if len(history) > 0:
            _record(history, index, state.pose, view, command)
        before = state.pose
        if index < case.steps:
            state = plant_step(state, command, draw(seed, run, index, WHEEL_BLOCK), case.plant)
        totals = _added(totals, case, index, memory.switching.region, command, before, state.pose)
    return _outcome(case, totals, memory.switching.switches, view, state.pose)


def _uncertainty(case: Case, view: View) -> Uncertainty:
    """What the controller is told of the estimate; a fix or the truth is taken at its word."""
    if case.feedback != EKF:
        return Uncertainty(0.0, 0.0)
    return _spread(view.track)


def _spread(track: Track | None) -> Uncertainty:
    if track is None:
        return Uncertainty(0.0, 0.0)
    P = track.belief.P
    return Uncertainty(largest_deviation(P.xx, P.xy, P.yy), math.sqrt(max(P.tt, 0.0)))


def _observe(case: Case, seed: int, run: int, index: int, state: PlantState, view: View) -> View:
    """Sense and filter."""
    if case.feedback == TRUTH:
        return View(view.track, state.pose, True)
    moment = NoiseKey(seed, run, index)
    if case.feedback == RAW:
        if due(index, case.sensors.fix_rate, case.plant.sampling_time):
            fix, lost = fix_at(moment, state.pose, case.sensors)
            if not lost:
                return View(view.track, fix, True)
        return view
    return _filtered(view.track, case.filter, case, moment, state)


def _begun(options: FilterOptions | None) -> Track | None:
    if options is None:
        return None
    return new_track(options)


def _filtered(
    track: Track | None, options: FilterOptions | None, case: Case, moment: NoiseKey, state: PlantState
) -> View:
    """Sense and filter; numba leaves out the branch behind an argument that is None by its type."""
    if track is None or options is None:
        return View(track, state.pose, False)
    track = observe(track, moment, state, Robot(case.plant, case.sensors, options, case.landmarks))
    return View(track, track.belief.pose, track.initialised)


def _added(
    totals: RunTotals, case: Case, index: int, region: int, command: Twist, before: Pose, after: Pose
) -> RunTotals:
    """Add one step, from the true pose ``before`` to ``after``."""
    t_s = case.plant.sampling_time
    local = into_frame(before, case.goal)
    inside = math.hypot(local.x, local.y) <= case.xy_tolerance and abs(local.theta) <= case.yaw_tolerance
    first_local = region == OMEGA_L and math.isnan(totals.local_time)
    power = command.v * command.v + command.omega * command.omega if index < case.steps else 0.0
    return RunTotals(
        totals.last_outside if inside else index,  # nan is not inside
        totals.path_length + math.hypot(after.x - before.x, after.y - before.y),
        totals.effort + power * t_s,
        index * t_s if first_local else totals.local_time,
    )


def _record(history: Any, index: int, pose: Pose, view: View, command: Twist) -> None:
    row = history[index]
    row[0], row[1], row[2] = pose.x, pose.y, pose.theta
    row[3], row[4], row[5] = math.nan, math.nan, math.nan
    if view.has_seen:
        row[3], row[4], row[5] = view.seen.x, view.seen.y, view.seen.theta
    row[6], row[7] = command.v, command.omega


def _outcome(case: Case, totals: RunTotals, switches: int, view: View, pose: Pose) -> Outcome:
    local = into_frame(pose, case.goal)
    settled = math.nan
    if totals.last_outside < case.steps:
        settled = (totals.last_outside + 1) * case.plant.sampling_time
    error = math.nan
    if view.has_seen:
        error = math.hypot(view.seen.x - pose.x, view.seen.y - pose.y)
    return Outcome(
        local.x,
        local.y,
        local.theta,
        settled,
        totals.path_length,
        totals.effort,
        float(switches),
        totals.local_time,
        error,
    )
