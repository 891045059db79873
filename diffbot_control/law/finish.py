"""The last centimetres: an error that remains in Omega_L is worked off by legs along the goal's axis.

In Omega_L every (0, y, 0) is an equilibrium, and how large y is becomes known only while the robot rests. A *leg* is
driven along the axis, backwards or forwards, with a bounded heading towards it, to a point behind or in front of the
goal. There are two kinds. A lateral error that uses up most of the tolerance is worked off by legs *to and fro*, so
short and so little turned that they stay inside the tolerances. An error beyond the tolerance, or a heading that only
motion can make known, takes a *V*: a leg out behind the goal and one in again, as long as the error needs. A robot that
must not reverse leaves Omega_L instead, and approaches again.

Each begins after a moment at rest, for an error that is larger than its standard deviation then, and a V only while the
goal does not count as reached.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance, knowable_heading
from diffbot_control.law.limits import limit_local
from diffbot_control.law.speed_profile import ProfileGains, signed_braking
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.ranges import SHARE, SPEED
from diffbot_core.schema import Spec, known_fields
from diffbot_core.uncertainty import CERTAIN, Uncertainty

NO_LEG, TO_AND_FRO, V_LEG, LEAVING = 0, 1, 2, 3
FINISH_NAMES = ("resting", "to and fro", "out and in", "leaving")

_END = 0.6
"""share of the lateral error that began legs to and fro, which ends them"""
_REACH = 0.5
"""share of the tolerance: distance from the goal at which a leg to and fro ends"""
_LEGS = 12
"""legs to and fro at most, before the robot rests again"""
_CERTAIN = 0.3
"""share of the tolerance: a V is driven with a position at least as certain as this"""
_V_HEADING = 0.3
"""[rad] bound of |heading| in a V"""
_V_SPEED = 2.0
"""speed of a V in multiples of ``finish_speed``"""
_MARGIN = 0.15
"""share of the tolerance: a leg is over this far before its end"""
_LINE_GAIN = 8.0
"""[rad/m] heading per metre of lateral error"""
_END_GAIN = 1.5
"""[1/s] speed per metre from the end of the leg"""
_SLOWEST = 0.2
"""share of ``finish_speed`` that a leg ends with"""


@known_fields
class FinishConfig(NamedTuple):
    """When and how an error is worked off at rest."""

    finish_wait: Annotated[float, Spec("time at rest before a leg may begin", "s", minimum=0.0, maximum=3600.0)] = 1.9
    finish_begin: Annotated[
        float, Spec("lateral error that begins legs to and fro, share of xy_goal_tolerance; 1: none", "-", 0.0, 1.0)
    ] = 0.4
    finish_heading: Annotated[
        float, Spec("bound of |heading| on legs to and fro, share of yaw_goal_tolerance", "-", *SHARE)
    ] = 0.68
    finish_speed: Annotated[float, Spec("bound of |v| on legs to and fro; a V is twice as fast", "m/s", *SPEED)] = 0.14


class Finish(NamedTuple):
    """Progress of the finish; the default is that of a new goal."""

    kind: int = NO_LEG
    side: float = 0.0
    """direction of the present leg: forwards (1) or backwards (-1)"""
    reach: float = 0.0
    """[m] distance from the goal at which it ends; of a V, at which the leg out ends"""
    legs: int = 0
    """left, the present one included"""
    rest: float = 0.0
    """[s] at rest in a row"""


class Standing(NamedTuple):
    """How the robot stands at a pose."""

    rest: float
    """[s] at rest in a row without a leg, this pose included; 0 if the robot moves"""
    reached: bool
    """the goal counts as reached"""
    allow_backward: bool
    """the robot may reverse"""


def no_finish(rest: float = 0.0) -> Finish:
    """Return the state without a leg, every field given: compiled code does not know the defaults."""
    return Finish(NO_LEG, 0.0, 0.0, 0, rest)


def is_leg(state: Finish) -> bool:
    """Whether a leg is being driven."""
    return state.kind == TO_AND_FRO or state.kind == V_LEG  # noqa: PLR1714 - compiled code compares numbers faster


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
        standing: how the robot stands.
        uncertainty: of the estimate.
        tolerance: of the goal.
        config: when and how.
    """
    length, lateral = tolerance.xy_goal_tolerance, abs(local.y)
    rest, reached, allow_backward = standing
    if is_leg(state):
        # Legs need both directions, and reversing may be forbidden after they began.
        return _next_leg(state, local, tolerance, config) if allow_backward else no_finish()
    if rest <= 0.0 or rest < config.finish_wait:
        return no_finish(rest)
    if not reached and uncertainty.xy < v_sigma_max(tolerance):
        reach = _v_reach(lateral, uncertainty, tolerance)
        if not allow_backward:
            return Finish(LEAVING, 0.0, 0.0, 0, 0.0) if lateral > config.finish_begin * length else no_finish(rest)
        if reach > 0.0:
            return Finish(V_LEG, -1.0, reach + 0.5 * _MARGIN * length, 2, 0.0)
    if allow_backward and lateral > max(config.finish_begin * length, uncertainty.xy):
        return Finish(TO_AND_FRO, -1.0 if local.x >= 0.0 else 1.0, _reach(lateral, length), _LEGS, 0.0)
    return no_finish(rest)


def _reach(lateral: float, length: float) -> float:
    """Return how far [m] a leg to and fro goes: less where its end would be beyond the tolerance."""
    room = length * length - lateral * lateral
    return _REACH * length if room <= 0.0 else min(_REACH * length, math.sqrt(room) + _MARGIN * length)


def longest_reach(lateral: float, tolerance: GoalTolerance) -> float:
    """Largest distance [m] from the goal to which a leg goes that begins with an estimated |y| <= ``lateral`` [m].

    The heading is known well enough for the goal to be reached.
    """
    length = tolerance.xy_goal_tolerance
    return max(_REACH * length, _v_reach(lateral, CERTAIN, tolerance) + 0.5 * _MARGIN * length)


def v_sigma_max(tolerance: GoalTolerance) -> float:
    """Standard deviation [m] of the position below which a V may begin."""
    return _CERTAIN * tolerance.xy_goal_tolerance


def fastest_leg(config: FinishConfig) -> float:
    """Bound of |v| [m/s] on every leg."""
    return _V_SPEED * config.finish_speed


def _v_reach(lateral: float, uncertainty: Uncertainty, tolerance: GoalTolerance) -> float:
    """Return how far [m] a V goes out; 0 if none is needed.

    With the heading ``_V_HEADING`` each of its legs works off half of the lateral error. A heading that is unknown at
    rest shows in the direction of the motion: over a distance d the position tells it to sqrt(2) sigma_xy / d.
    """
    reach = 0.0
    if lateral > tolerance.xy_goal_tolerance:
        reach = 0.5 * lateral / math.tan(_V_HEADING)
    if not knowable_heading(tolerance, uncertainty):
        reach = max(reach, 4.0 * uncertainty.xy / tolerance.yaw_goal_tolerance)
    return reach


def _next_leg(state: Finish, local: Pose, tolerance: GoalTolerance, config: FinishConfig) -> Finish:
    length = tolerance.xy_goal_tolerance
    if state.side * (local.x - _end_of(state)) < -_MARGIN * length:
        return state
    if state.legs <= 1 or (state.kind == TO_AND_FRO and abs(local.y) <= _END * config.finish_begin * length):
        return no_finish()
    reach = _reach(abs(local.y), length) if state.kind == TO_AND_FRO else state.reach
    return Finish(state.kind, -state.side, reach, state.legs - 1, 0.0)


def _end_of(state: Finish) -> float:
    """Return the x [m] of the end of the leg: a V comes back to the goal."""
    return 0.0 if state.kind == V_LEG and state.legs == 1 else state.side * state.reach


def finish_command(
    state: Finish, local: Pose, tolerance: GoalTolerance, config: FinishConfig, gains: ProfileGains, sheet: DataSheet
) -> Twist:
    """Return the command of a leg, within the bounds of the velocities: along the axis with a heading towards it."""
    bound, fastest = config.finish_heading * tolerance.yaw_goal_tolerance, config.finish_speed
    if state.kind == V_LEG:
        bound, fastest = _V_HEADING, _V_SPEED * config.finish_speed
    v = _END_GAIN * (_end_of(state) - local.x)
    v = math.copysign(min(max(abs(v), _SLOWEST * config.finish_speed), fastest), v)
    heading = min(max(-_LINE_GAIN * local.y, -bound), bound) * math.copysign(1.0, v)
    error = local.theta - heading
    omega = -signed_braking(error, gains.hold_brake, gains.hold_react, sheet.omega_max)
    # Turned first, then driven: the way is short.
    v *= max(0.0, 1.0 - abs(error) / (2.0 * bound))
    return limit_local(Twist(v, omega), sheet)
