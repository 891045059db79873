"""Re-approach: a lateral error that remains at rest is removed by retreating along the goal's axis and coming back.

In Omega_L every (0, y, 0) is an equilibrium of the paper's law, so the remaining y stays, and the global law would
swing the heading by radians this close to the goal. Here the robot follows the goal's x axis as a line, backwards and
forwards, with a bounded heading: y decays along the way, and heading and speed are back at zero at its end.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec, known_fields
from diffbot_core.uncertainty import Uncertainty

RESTING, RETREATING, APPROACHING = 0, 1, 2
PHASE_NAMES = ("resting", "retreating", "approaching")

_WINDOW = 35.0
"""[s] after coming to rest in which a re-approach may begin"""
_SPEED = 0.25
"""[m/s]"""
_HEADING = 0.25
"""[rad] bound of |heading|"""
_DISTANCE, _SLOPE = 0.15, 3.0
"""[m] smallest retreat distance, and what is added per metre of lateral error"""
_SHARE = 0.7
"""share of xy_goal_tolerance that a lateral error may use"""
_SIGMAS = 2.0
"""standard deviations of the position by which the tolerance is reduced"""
_LINE_GAIN = 8.0
"""[rad/m] heading per metre of lateral error"""
_DISTANCE_GAIN = 1.3
"""[1/s] speed per metre from the end of the phase"""
_END_MARGIN = 0.03
"""[m] A phase is over this far before its end, at most a quarter of the retreat distance: convergence is asymptotic."""


@known_fields
class ReapproachConfig(NamedTuple):
    """Whether the robot re-approaches."""

    reapproach_tries: Annotated[
        int, Spec("re-approaches for each goal (speed_profile tanh); 0: none", minimum=0, maximum=100)
    ] = 3


class Reapproach(NamedTuple):
    """Progress of the re-approach; the default is that of a new goal."""

    phase: int = RESTING
    tries: int = 0
    """begun so far"""
    quiet_steps: int = 0
    """poses in a row at rest with too large a lateral error"""
    time: float = 0.0
    """[s] since the robot first came to rest in Omega_L"""
    retreat_distance: float = 0.0
    """[m] of the present try; 0 at rest"""


def without_reapproach(state: Reapproach) -> Reapproach:
    """Return the state at rest, with the tries and the time of this goal kept."""
    if state.phase == RESTING and state.quiet_steps == 0 and state.retreat_distance == 0.0:
        return state
    return Reapproach(RESTING, state.tries, 0, state.time, 0.0)


def next_reapproach(
    state: Reapproach,
    local: Pose,
    resting: bool,
    uncertainty: Uncertainty,
    dt: float,
    tolerance: GoalTolerance,
    config: ReapproachConfig,
) -> Reapproach:
    """Advance by one pose inside Omega_L.

    A try begins when the robot has rested for ``settling_steps`` poses with a lateral error that is too large for the
    goal and larger than its own standard deviation: an error that is not known cannot be corrected. It begins within
    35 s or not at all, because the estimate keeps changing a little and the robot has to come to rest.

    Args:
        state: as left by the last pose.
        local: estimate in the goal's frame.
        resting: whether speed and heading are within the tolerances.
        uncertainty: of the estimate.
        dt: [s] since the last pose.
        tolerance: of the goal.
        config: when and how.
    """
    time = state.time + dt if resting or state.time > 0.0 else 0.0
    margin = min(_END_MARGIN, 0.25 * state.retreat_distance)
    if state.phase == RETREATING:
        phase = APPROACHING if local.x < margin - state.retreat_distance else RETREATING
        return Reapproach(phase, state.tries, 0, time, state.retreat_distance)
    if state.phase == APPROACHING:
        phase = RESTING if local.x > -margin else APPROACHING
        return Reapproach(phase, state.tries, 0, time, state.retreat_distance)
    lateral = abs(local.y)
    quiet_steps = state.quiet_steps + 1 if resting and lateral > allowed_error(uncertainty, tolerance) else 0
    may_begin = time <= _WINDOW and state.tries < config.reapproach_tries
    if may_begin and quiet_steps >= tolerance.settling_steps:
        retreat_distance = _DISTANCE + _SLOPE * lateral
        return Reapproach(RETREATING, state.tries + 1, 0, time, retreat_distance)
    return Reapproach(RESTING, state.tries, quiet_steps, time, 0.0)


def allowed_error(uncertainty: Uncertainty, tolerance: GoalTolerance) -> float:
    """Lateral error [m] up to which no re-approach begins."""
    largest = tolerance.xy_goal_tolerance
    allowed = min(largest - _SIGMAS * uncertainty.xy, _SHARE * largest)
    return max(allowed, uncertainty.xy)


def reapproach_command(state: Reapproach, local: Pose, heading_gain: float) -> Twist:
    """Return the command while retreating or approaching: towards the end of the phase, along the axis.

    The requested heading is proportional to y and to the speed, so it changes sign with the direction of travel and is
    zero at the ends.

    Args:
        state: phase and retreat distance.
        local: estimate in the goal's frame.
        heading_gain: [1/s] of the heading's control, k_2 of the law.
    """
    end = -state.retreat_distance if state.phase == RETREATING else 0.0
    speed = _DISTANCE_GAIN * (end - local.x)
    speed = min(max(speed, -_SPEED), _SPEED)
    heading = -_LINE_GAIN * local.y * speed / _SPEED
    heading = min(max(heading, -_HEADING), _HEADING)
    return Twist(speed, -heading_gain * (local.theta - heading))
