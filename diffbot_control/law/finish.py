"""The last centimetres: a lateral error that remains at rest is worked off inside the goal's tolerance.

In Omega_L every (0, y, 0) is an equilibrium, so y stays. Before the goal counts as reached, the robot goes to and fro
along the goal's axis with a small heading towards it. Way and heading are so small that the tolerance is not left,
and so this costs no settling time. It waits until the estimate allows that. With an error beyond the tolerance the
robot leaves Omega_L and approaches again. Where Omega_L is wider, or the position stays uncertain, it goes out along
the axis and in again instead.

All lengths are shares of ``finish_length``, by default the position tolerance.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.limits import limit_local
from diffbot_control.law.speed_profile import ProfileGains, signed_braking
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.ranges import SHARE, SPEED
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import Uncertainty

RESTING, SHUTTLING, LEAVING = 0, 1, 2
"""at rest or not in Omega_L; going to and fro inside the tolerance; leaving it and coming back"""
FINISH_NAMES = ("resting", "to and fro", "out and in")

_END = 0.15
"""share: a leg is over this far before its end"""
_OUT_END = 0.6
"""share: likewise on the way out"""
SHORTEST_LEG = 0.3
"""share: a shorter leg corrects nothing"""
_ENOUGH_CERTAIN = 0.2
"""share: with a position as certain as this, the shortest leg is allowed whatever the room"""
_MISSED_CERTAIN = 0.3
"""share: with a position as certain as this, an error beyond ``finish_missed`` is acted on"""
_MISSED_SIGMAS = 1.2
"""... or with an error of so many standard deviations: errors of fixes that last may keep the position uncertain"""
_PATIENCE = 6.0
"""[s] at rest after which ..."""
_PATIENT_SIGMAS = 1.0
"""... the shortest leg needs room for so many standard deviations only, and, while the goal cannot count as reached
with this uncertainty, an error this near to the tolerance is acted on: errors of fixes that last keep the position
uncertain for longer than it is worth waiting for"""
_LEGS = 12
"""legs of one try"""
_OUT_SLOPE = 2.0
"""way out added per metre of lateral error"""
_OUT_HEADING, _OUT_SPEED = 0.3, 0.3
"""[rad], [m/s] on the way out and in"""
_END_GAIN = 2.0
"""[1/s] speed per metre from the end of the leg"""
_LINE_GAIN = 8.0
"""[rad/m] heading per metre of lateral error"""
_SLOWEST = 0.2
"""share of ``finish_speed`` that a leg ends with"""


class FinishConfig(NamedTuple):
    """When and how a lateral error is worked off at rest."""

    finish_tries: Annotated[int, Spec("tries for each goal; 0: none", minimum=0, maximum=1000)] = 12
    finish_window: Annotated[
        float, Spec("time after coming to rest in which a try may begin", "s", minimum=0.0, maximum=3600.0)
    ] = 48.0
    finish_length: Annotated[
        float, Spec("length that the shares of the finish refer to; 0: xy_goal_tolerance", "m", 0.0, 10.0)
    ] = 0.0
    finish_begin: Annotated[float, Spec("lateral error that begins a try, share of the length", "-", 0.0, 10.0)] = 0.25
    finish_begin_sigmas: Annotated[
        float,
        Spec(
            "a lateral error has to exceed so many standard deviations of the position to begin a try", "-", 0.0, 10.0
        ),
    ] = 0.8
    finish_end: Annotated[float, Spec("lateral error that ends a try, share of the length", "-", 0.0, 10.0)] = 0.08
    finish_reach: Annotated[float, Spec("longest leg from the goal, share of the length", "-", 0.0, 10.0)] = 0.6
    finish_room: Annotated[
        float, Spec("circle about the goal that a try stays in, share of the length", "-", 0.0, 10.0)
    ] = 1.0
    finish_room_sigmas: Annotated[
        float, Spec("standard deviations of the position by which that circle is reduced", "-", 0.0, 10.0)
    ] = 2.5
    finish_heading: Annotated[
        float, Spec("bound of |heading| during a try, share of yaw_goal_tolerance", "-", *SHARE)
    ] = 0.5
    finish_speed: Annotated[float, Spec("bound of |v| during a try", "m/s", *SPEED)] = 0.15
    finish_missed: Annotated[
        float, Spec("lateral error that makes the robot leave the tolerance, share of the length", "-", 0.0, 100.0)
    ] = 1.0


class Finish(NamedTuple):
    """Progress of the finish; the default is that of a new goal."""

    phase: int = RESTING
    side: float = 0.0
    """end of the present leg: in front of the goal (1) or behind it (-1)"""
    reach: float = 0.0
    """[m] distance of that end from the goal"""
    tries: int = 0
    """begun so far"""
    quiet_steps: int = 0
    """poses in a row at rest with too large a lateral error"""
    time: float = 0.0
    """[s] since the robot first came to rest in Omega_L"""
    legs: int = 0
    """ended in this try"""


class Standing(NamedTuple):
    """How the robot stands at a pose."""

    resting: bool
    """speed and heading are within the tolerances"""
    inside: bool
    """within the leaving radius of Omega_L: no switch is counted"""
    reached: bool
    """the goal counts as reached: nothing begins any more"""
    dt: float
    """[s] since the last pose"""


class FinishScale(NamedTuple):
    """Sizes that follow from goal and uncertainty."""

    length: float
    """[m]"""
    begins: float
    """[m] lateral error from which a try begins"""
    room: float
    """[m] distance from the goal that may be used"""
    missed: bool
    """the lateral error is beyond the tolerance, and certainly so"""


def without_finish(state: Finish) -> Finish:
    """Return the state at rest, with the tries and the time of this goal kept."""
    if state.phase == RESTING and state.quiet_steps == 0:
        return state  # as in most steps: a new tuple costs time
    return Finish(RESTING, 0.0, 0.0, state.tries, 0, state.time, 0)


def finish_scale(
    lateral: float, uncertainty: Uncertainty, tolerance: GoalTolerance, config: FinishConfig, patient: bool
) -> FinishScale:
    """Work out the sizes for a lateral error [m] >= 0; ``patient`` after a while at rest.

    A try begins early enough for the goal to count as reached without one.
    """
    length = config.finish_length if config.finish_length > 0.0 else tolerance.xy_goal_tolerance
    sigma = uncertainty.xy
    allowed = tolerance.xy_goal_tolerance - tolerance.goal_sigmas * sigma
    begins = config.finish_begin * length
    if config.finish_end * length < allowed < begins:
        begins = allowed
    room = config.finish_room * length - config.finish_room_sigmas * sigma
    certain = sigma < max(_MISSED_CERTAIN * length, lateral / _MISSED_SIGMAS)
    bound = config.finish_missed * length
    if patient and allowed <= 0.0:
        bound = min(bound, length - _PATIENT_SIGMAS * sigma)
    missed = lateral > bound and certain
    return FinishScale(
        length,
        max(begins, config.finish_begin_sigmas * sigma),
        min(config.finish_reach * length, _free(lateral, room)),
        missed,
    )


def next_finish(
    state: Finish,
    local: Pose,
    standing: Standing,
    uncertainty: Uncertainty,
    tolerance: GoalTolerance,
    config: FinishConfig,
) -> Finish:
    """Advance by one pose inside Omega_L.

    Args:
        state: as left by the last pose.
        local: estimate in the goal's frame.
        standing: whether it rests, and where.
        uncertainty: of the estimate.
        tolerance: of the goal.
        config: when and how.
    """
    lateral = abs(local.y)
    resting, inside, reached, dt = standing
    time = state.time + dt if resting or state.time > 0.0 else 0.0
    scale = finish_scale(lateral, uncertainty, tolerance, config, time >= _PATIENCE)
    if state.phase != RESTING:
        if state.phase == SHUTTLING and scale.missed and inside:
            return _way_out(lateral, state.tries, time, scale)
        return _next_leg(state, local, time, scale, config)
    quiet_steps = state.quiet_steps + 1 if resting and not reached and lateral > scale.begins else 0
    waiting = Finish(RESTING, 0.0, 0.0, state.tries, quiet_steps, time, 0)
    if quiet_steps < tolerance.settling_steps or state.tries >= config.finish_tries or time > config.finish_window:
        return waiting
    if scale.missed:
        return _way_out(lateral, state.tries + 1, time, scale)
    reach, shortest = scale.room, SHORTEST_LEG * scale.length
    patient = time >= _PATIENCE and _free(lateral, scale.length - _PATIENT_SIGMAS * uncertainty.xy) > shortest
    if reach < shortest and (patient or uncertainty.xy < _ENOUGH_CERTAIN * scale.length):
        reach = shortest
    if reach < shortest:
        # Not yet: the tolerance might be left. At rest the estimate gets better.
        return waiting
    return Finish(SHUTTLING, -1.0 if local.x >= 0.0 else 1.0, reach, state.tries + 1, 0, time, 0)


def _free(lateral: float, room: float) -> float:
    """Return the half chord [m] of a circle of radius ``room``, at the distance ``lateral`` from its centre."""
    return math.sqrt(room * room - lateral * lateral) if room > lateral else 0.0


def _way_out(lateral: float, tries: int, time: float, scale: FinishScale) -> Finish:
    return Finish(LEAVING, -1.0, scale.length + _OUT_SLOPE * lateral, tries, 0, time, 0)


def _next_leg(state: Finish, local: Pose, time: float, scale: FinishScale, config: FinishConfig) -> Finish:
    """Advance a try that is under way."""
    leaving = state.phase == LEAVING
    lateral = abs(local.y)
    margin = _OUT_END if leaving and state.reach > scale.length else _END
    if state.side * local.x < state.reach - margin * scale.length:
        return Finish(state.phase, state.side, state.reach, state.tries, 0, time, state.legs)
    if lateral <= config.finish_end * scale.length or (leaving and state.legs >= 1) or state.legs >= _LEGS:
        return Finish(RESTING, 0.0, 0.0, state.tries, 0, time, 0)
    reach = 0.0 if leaving else max(scale.room, SHORTEST_LEG * scale.length)
    return Finish(state.phase, -state.side, reach, state.tries, 0, time, state.legs + 1)


def is_pending(state: Finish, config: FinishConfig) -> bool:
    """Whether a try is under way or about to begin, so that the goal must not count as reached yet."""
    if state.phase != RESTING:
        return True
    return state.quiet_steps > 0 and state.tries < config.finish_tries and state.time <= config.finish_window


def finish_command(
    state: Finish,
    local: Pose,
    tolerance: GoalTolerance,
    config: FinishConfig,
    gains: ProfileGains,
    data_sheet: DataSheet,
) -> Twist:
    """Return the command of a try, within the bounds of the velocities: along the axis with a heading towards it."""
    bound, fastest = config.finish_heading * tolerance.yaw_goal_tolerance, config.finish_speed
    if state.phase == LEAVING:
        bound, fastest = _OUT_HEADING, _OUT_SPEED
    v = _END_GAIN * (state.side * state.reach - local.x)
    v = math.copysign(min(max(abs(v), _SLOWEST * config.finish_speed), fastest), v)
    heading = min(max(-_LINE_GAIN * local.y, -bound), bound) * math.copysign(1.0, v)
    error = local.theta - heading
    omega = -signed_braking(error, gains.hold_brake, gains.hold_react, data_sheet.omega_max)
    # Turned first, then driven: the way is short.
    v *= max(0.0, 1.0 - abs(error) / (2.0 * bound))
    return limit_local(Twist(v, omega), data_sheet)
