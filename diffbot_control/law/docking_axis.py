"""The axis of a dock: commands along the axis, and the predicted error at contact.

Poses are in the dock's frame: its origin is the position of the docked robot, and its x axis is the heading of the
docked robot. Let x, y, theta be the pose of the robot, and v > 0 its speed towards the dock. On the axis

    omega = -v y sinc(theta) / lambda^2 - 2 |v| theta / lambda,      V = (y^2 / lambda^2 + theta^2) / 2

so dV = -2 |v| theta^2 / lambda <= 0 at any speed, in both directions. As a function of the distance driven, y has a
double pole at -1 / lambda at any speed. A robot that stands does not turn. V <= CORRIDOR^2 / 2 bounds y and theta until
contact. From ``commit_distance`` on, the robot only holds its heading, as in Omega_L: omega = -2 |v| theta / lambda. A
correction of y so near the dock would leave a heading error at contact. :func:`contact_error` predicts the errors at
contact from the pose. If the robot docks with its back, the frame is turned by pi, see :func:`forward_pose`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.law.configuration import DockingConfig
from diffbot_control.law.steering import sinc
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Uncertainty

MAX_UNCERTAINTY = 0.1
"""[m] deviation of the position above which a pose in the dock's frame is useless"""
APPROACH_LENGTH = 0.08
"""[m] lambda, the length over which a lateral error decays on the axis"""
CORRIDOR = 0.4
"""[rad] largest sqrt(y^2 / lambda^2 + theta^2) at which the approach begins"""
STRAIGHT_LENGTH = 0.05
"""[m] distance before contact within which the robot does not steer"""
_SIGMAS = 2.6
"""The robot commits if the predicted error plus this number of standard deviations is within the tolerances."""


class ContactError(NamedTuple):
    """Predicted error at contact."""

    y: float
    """[m] lateral error"""
    theta: float
    """[rad] heading error"""


def pose_on_axis(distance: float, backward: bool) -> Pose:
    """Return the pose on the axis ``distance`` [m] before the docked pose, in the dock's frame."""
    return Pose(distance if backward else -distance, 0.0, 0.0)


def axis_lyapunov(pose: Pose, length: float) -> float:
    """Return V on the axis, with lambda = ``length`` [m]."""
    lateral = pose.y / length
    return 0.5 * (lateral * lateral + pose.theta * pose.theta)


def along_axis(pose: Pose, v: float, length: float) -> Twist:
    """Return the command with dV <= 0 for the velocity ``v`` [m/s], which is negative away from the dock."""
    curvature = pose.y * sinc(pose.theta) / (length * length)
    return Twist(v, -v * curvature - 2.0 * abs(v) * pose.theta / length)


def hold_heading(pose: Pose, v: float, length: float) -> Twist:
    """Return the command that reduces only the heading error, at the velocity ``v`` [m/s]."""
    return Twist(v, -2.0 * abs(v) * pose.theta / length)


def contact_error(pose: Pose, config: DockingConfig) -> ContactError:
    """Predict the error at contact from a pose in the dock's frame, by the linearised motion without disturbances.

    As functions of the distance driven: y'' + 2 y' / lambda + y / lambda^2 = 0 until ``commit_distance``, then
    theta' = -2 theta / lambda until STRAIGHT_LENGTH, and a constant theta on the last part.
    """
    length, distance = APPROACH_LENGTH, max(-pose.x, 0.0)
    straight = min(STRAIGHT_LENGTH, distance)
    hold = max(min(config.commit_distance, distance) - straight, 0.0)
    steered = max(distance - straight - hold, 0.0)
    slope, left = pose.y / length + pose.theta, math.exp(-steered / length)
    y, theta = (pose.y + slope * steered) * left, (pose.theta - slope * steered / length) * left
    held = math.exp(-2.0 * hold / length)
    y, theta = y + 0.5 * length * theta * (1.0 - held), theta * held
    return ContactError(y + straight * theta, theta)


def is_within(error: ContactError, share: float, config: DockingConfig) -> bool:
    """Return True if the error is within this share of the tolerances."""
    return abs(error.y) <= share * config.dock_xy_tolerance and abs(error.theta) <= share * config.dock_yaw_tolerance


def is_certain(error: ContactError, distance: float, uncertainty: Uncertainty, config: DockingConfig) -> bool:
    """Return True if the error and its deviations, ``distance`` [m] before contact, are within the tolerances."""
    lateral = math.hypot(uncertainty.xy, distance * uncertainty.theta)
    return (
        abs(error.y) + _SIGMAS * lateral <= config.dock_xy_tolerance
        and abs(error.theta) + _SIGMAS * uncertainty.theta <= config.dock_yaw_tolerance
    )


def forward_pose(pose: Pose, config: DockingConfig) -> Pose:
    """Return the pose of a robot that docks with its front: if it docks with its back, turn the frame by pi."""
    if not config.dock_backward:
        return pose
    return Pose(-pose.x, -pose.y, pose.theta)


def is_inside(pose: Pose, scale: float) -> bool:
    """Return True if a pose is in the corridor whose bound is ``scale`` * CORRIDOR."""
    return math.sqrt(2.0 * axis_lyapunov(pose, APPROACH_LENGTH)) <= scale * CORRIDOR
