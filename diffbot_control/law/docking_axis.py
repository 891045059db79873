"""The axis of a dock: commands along it, and the predicted error at contact.

Poses are in the dock's frame: its origin is where the docked robot stands, and its x axis points as that robot does.
Let x, y, theta be the pose of the robot, and v > 0 its speed towards the dock. On the axis

    omega = -v y sinc(theta) / lambda^2 - 2 |v| theta / lambda,      V = (y^2 / lambda^2 + theta^2) / 2

so dV = -2 |v| theta^2 / lambda <= 0 at any speed, in and out. As a function of the distance driven, y has a double pole
at -1 / lambda, whatever the speed, and a robot that stands does not turn. V <= CORRIDOR^2 / 2 bounds y and theta until
the end. From ``commit_distance`` on, the robot only holds its heading, as in Omega_L: omega = -2 |v| theta / lambda. A
correction of y would leave it turned at contact. So the errors at contact follow from the pose, see :func:`arrival`.
For a robot that docks with its back, the frame is turned by pi, see :func:`leading`.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_control.law.steering import sinc
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.schema import ANGLE, LENGTH, SPEED, Spec, known_fields
from diffbot_core.uncertainty import Uncertainty

MAX_UNCERTAINTY = 0.1
"""[m] deviation of the position beyond which a pose in the dock's frame is useless"""
APPROACH_LENGTH = 0.08
"""[m] lambda, the length in which a lateral error decays on the axis"""
CORRIDOR = 0.4
"""[rad] bound of sqrt(y^2 / lambda^2 + theta^2) where the approach begins"""
STRAIGHT_LENGTH = 0.05
"""[m] distance before contact from which on the robot does not steer"""
_SIGMAS = 2.6
"""number of deviations that have to fit into the tolerances, besides the predicted error, before the robot commits"""


@known_fields
class DockingConfig(NamedTuple):
    """Parameters of docking; ``drive`` is the configuration of the law that drives to the staging pose.

    ``allow_backward`` applies to this drive alone. On the axis the robot always drives out in the opposite direction.
    """

    dock_backward: Annotated[bool, Spec("the back of the robot docks")] = False
    staging_distance: Annotated[float, Spec("distance of the staging pose from the docked one", "m", *LENGTH)] = 0.7
    commit_distance: Annotated[
        float, Spec("the robot goes nearer only if it will dock within the tolerances", "m", 0.0, 10.0)
    ] = 0.33
    dock_speed: Annotated[float, Spec("speed along the axis", "m/s", *SPEED)] = 0.12
    contact_speed: Annotated[float, Spec("speed at contact", "m/s", *SPEED)] = 0.08
    press_distance: Annotated[
        float, Spec("how far beyond the docked pose the robot drives on until it feels the contact", "m", 0.0, 1.0)
    ] = 0.03
    dock_xy_tolerance: Annotated[
        float, Spec("largest lateral error at contact, including 2.6 of its deviations", "m", *LENGTH)
    ] = 0.02
    dock_yaw_tolerance: Annotated[
        float, Spec("largest heading error at contact, including 2.6 of its deviations", "rad", *ANGLE)
    ] = 0.013
    dock_tries: Annotated[int, Spec("approaches before the robot gives up", minimum=1, maximum=100)] = 3
    drive: SwitchingConfig = SwitchingConfig()


class Arrival(NamedTuple):
    """Predicted error at contact without disturbances."""

    y: float
    """[m]"""
    theta: float
    """[rad]"""


def pose_on_axis(distance: float, backward: bool) -> Pose:
    """Return the pose on the axis ``distance`` [m] before the docked one, in the dock's frame."""
    return Pose(distance if backward else -distance, 0.0, 0.0)


def axis_lyapunov(pose: Pose, length: float) -> float:
    """Return V on the axis, with lambda = ``length`` [m]."""
    lateral = pose.y / length
    return 0.5 * (lateral * lateral + pose.theta * pose.theta)


def along_axis(pose: Pose, v: float, length: float) -> Twist:
    """Return the command with the speed ``v`` [m/s], negative for the way out, that keeps dV <= 0."""
    curvature = pose.y * sinc(pose.theta) / (length * length)
    return Twist(v, -v * curvature - 2.0 * abs(v) * pose.theta / length)


def hold_heading(pose: Pose, v: float, length: float) -> Twist:
    """Return the command with the speed ``v`` [m/s] that holds the heading of the axis: theta^2 decays."""
    return Twist(v, -2.0 * abs(v) * pose.theta / length)


def arrival(pose: Pose, config: DockingConfig) -> Arrival:
    """Return the predicted error at contact from a pose in the dock's frame, linearised.

    Until ``commit_distance`` y'' + 2 y' / lambda + y / lambda^2 = 0 over the way, then theta' = -2 theta / lambda until
    STRAIGHT_LENGTH, then neither changes.
    """
    length, distance = APPROACH_LENGTH, max(-pose.x, 0.0)
    straight = min(STRAIGHT_LENGTH, distance)
    hold = max(min(config.commit_distance, distance) - straight, 0.0)
    way = max(distance - straight - hold, 0.0)
    slope, left = pose.y / length + pose.theta, math.exp(-way / length)
    y, theta = (pose.y + slope * way) * left, (pose.theta - slope * way / length) * left
    held = math.exp(-2.0 * hold / length)
    y, theta = y + 0.5 * length * theta * (1.0 - held), theta * held
    return Arrival(y + straight * theta, theta)


def fits(at: Arrival, share: float, config: DockingConfig) -> bool:
    """Return True if the error is within this share of the tolerances."""
    return abs(at.y) <= share * config.dock_xy_tolerance and abs(at.theta) <= share * config.dock_yaw_tolerance


def is_certain(at: Arrival, distance: float, uncertainty: Uncertainty, config: DockingConfig) -> bool:
    """Return True if error and uncertainty of a pose ``distance`` [m] before contact fit into the tolerances."""
    across = math.hypot(uncertainty.xy, distance * uncertainty.theta)
    return (
        abs(at.y) + _SIGMAS * across <= config.dock_xy_tolerance
        and abs(at.theta) + _SIGMAS * uncertainty.theta <= config.dock_yaw_tolerance
    )


def leading(pose: Pose, config: DockingConfig) -> Pose:
    """Return the pose of the leading end; for a robot that docks backwards, the dock's frame is turned by pi."""
    if not config.dock_backward:
        return pose
    return Pose(-pose.x, -pose.y, pose.theta)


def is_inside(pose: Pose, wider: float) -> bool:
    """Return True if a pose is in the corridor, a sublevel set of V, with its bound times ``wider``."""
    return math.sqrt(2.0 * axis_lyapunov(pose, APPROACH_LENGTH)) <= wider * CORRIDOR
