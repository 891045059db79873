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
from diffbot_core.ranges import GAIN, SHARE, SLOPE, SPEED
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import Uncertainty

RESTING, RETREATING, APPROACHING = 0, 1, 2
PHASE_NAMES = ("resting", "retreating", "approaching")

_END_MARGIN = 0.03
"""[m] A phase is over this far before its end, at most a quarter of the retreat distance: convergence is asymptotic."""


class ReapproachConfig(NamedTuple):
    """When and how the robot re-approaches."""

    reapproach_tries: Annotated[int, Spec("re-approaches for each goal; 0: none", minimum=0, maximum=100)] = 3
    reapproach_window: Annotated[
        float, Spec("time after coming to rest in which one may begin", "s", minimum=0.0, maximum=3600.0)
    ] = 35.0
    reapproach_speed: Annotated[float, Spec("speed", "m/s", *SPEED)] = 0.25
    reapproach_heading: Annotated[float, Spec("bound of |heading|", "rad", minimum=1e-3, maximum=1.0)] = 0.25
    reapproach_distance: Annotated[float, Spec("smallest retreat distance", "m", minimum=0.05, maximum=10.0)] = 0.15
    reapproach_share: Annotated[
        float,
        Spec("share of xy_goal_tolerance that a lateral error may use", "-", *SHARE),
    ] = 0.75
    reapproach_slope: Annotated[float, Spec("retreat distance added per metre of lateral error", "-", *SLOPE)] = 3.0
    reapproach_line_gain: Annotated[float, Spec("heading per metre of lateral error", "rad/m", *SLOPE)] = 8.0
    reapproach_distance_gain: Annotated[float, Spec("speed per metre from the end of the phase", "1/s", *GAIN)] = 1.3


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
    ``reapproach_window`` or not at all, because the estimate keeps changing a little and the robot has to come to rest.

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
    quiet_steps = state.quiet_steps + 1 if resting and lateral > allowed_error(uncertainty, tolerance, config) else 0
    may_begin = time <= config.reapproach_window and state.tries < config.reapproach_tries
    if may_begin and quiet_steps >= tolerance.settling_steps:
        retreat_distance = config.reapproach_distance + config.reapproach_slope * lateral
        return Reapproach(RETREATING, state.tries + 1, 0, time, retreat_distance)
    return Reapproach(RESTING, state.tries, quiet_steps, time, 0.0)


def allowed_error(uncertainty: Uncertainty, tolerance: GoalTolerance, config: ReapproachConfig) -> float:
    """Lateral error [m] up to which no re-approach begins."""
    largest = tolerance.xy_goal_tolerance
    allowed = min(largest - tolerance.goal_sigmas * uncertainty.xy, config.reapproach_share * largest)
    return max(allowed, uncertainty.xy)


def reapproach_command(state: Reapproach, local: Pose, heading_gain: float, config: ReapproachConfig) -> Twist:
    """Return the command while retreating or approaching: towards the end of the phase, along the axis.

    The requested heading is proportional to y and to the speed, so it changes sign with the direction of travel and is
    zero at the ends.

    Args:
        state: phase and retreat distance.
        local: estimate in the goal's frame.
        heading_gain: [1/s] of the heading's control, k_2 of the law.
        config: speed, gains and bounds.
    """
    end = -state.retreat_distance if state.phase == RETREATING else 0.0
    speed = config.reapproach_distance_gain * (end - local.x)
    speed = min(max(speed, -config.reapproach_speed), config.reapproach_speed)
    heading = -config.reapproach_line_gain * local.y * speed / config.reapproach_speed
    heading = min(max(heading, -config.reapproach_heading), config.reapproach_heading)
    return Twist(speed, -heading_gain * (local.theta - heading))
