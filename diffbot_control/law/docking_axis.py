"""The axis of a dock: following it, holding its heading, and which error a robot will arrive with.

Poses are in the dock's frame: its origin is where the docked robot stands, and its x axis points as that robot does.
Let x, y, theta be the pose of the robot, and v > 0 its speed towards the dock. On the axis

    omega = -v y sinc(theta) / lambda^2 - 2 |v| theta / lambda,      V = (y^2 / lambda^2 + theta^2) / 2

so dV = -2 |v| theta^2 / lambda <= 0 at any speed, in and out. Over the way, y has a double pole at -1 / lambda,
whatever the speed, and a robot that stands does not turn. V <= corridor^2 / 2 bounds y and theta until the end.
From ``commit_distance`` on the heading alone is held, as in Omega_L: omega = -2 |v| theta / lambda; a correction of y
there would leave the robot turned at contact. The errors at contact thus follow from the pose: :func:`arrival`.
A robot that docks with its back is taken in the frame turned round: :func:`leading`.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.lyapunov_law import sinc
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.ranges import ANGLE, LENGTH, SPEED
from diffbot_core.schema import Spec, known_fields
from diffbot_core.uncertainty import Uncertainty

MAX_UNCERTAINTY = 0.1
"""[m] deviation of the position beyond which a pose in the dock's frame says nothing"""
_SIGMAS = 2.6
"""deviations that have to fit into the tolerances beside the predicted error before the robot goes on blindly"""


@known_fields
class DockingConfig(NamedTuple):
    """How a robot docks; ``drive`` is the law that drives to the staging pose.

    Its ``allow_backward`` applies to that drive alone. On the axis the robot has to drive out the way it came in.
    """

    dock_backward: Annotated[bool, Spec("the back of the robot docks")] = False
    staging_distance: Annotated[float, Spec("distance of the staging pose from the docked one", "m", *LENGTH)] = 0.7
    approach_length: Annotated[
        float, Spec("lambda, the way in which a lateral error decays on the axis", "m", 0.02, 2.0)
    ] = 0.08
    corridor: Annotated[
        float, Spec("bound of sqrt(y^2 / lambda^2 + theta^2) where the approach begins", "rad", *ANGLE)
    ] = 0.4
    straight_length: Annotated[float, Spec("way before contact without any steering", "m", 0.0, 1.0)] = 0.05
    commit_distance: Annotated[
        float, Spec("the robot goes nearer only if it will dock within the tolerances", "m", 0.0, 10.0)
    ] = 0.33
    commit_timeout: Annotated[float, Spec("how long it waits there to become certain", "s", 0.0, 3600.0)] = 4.0
    dock_speed: Annotated[float, Spec("speed along the axis", "m/s", *SPEED)] = 0.12
    contact_speed: Annotated[float, Spec("speed at contact", "m/s", *SPEED)] = 0.08
    press_distance: Annotated[
        float, Spec("how far beyond the docked pose the robot drives on until it feels the contact", "m", 0.0, 1.0)
    ] = 0.03
    dock_xy_tolerance: Annotated[float, Spec("lateral error to dock with, likewise", "m", *LENGTH)] = 0.02
    dock_yaw_tolerance: Annotated[
        float, Spec("heading error to dock with, by the estimate and 2.6 of its deviations", "rad", *ANGLE)
    ] = 0.013
    dock_tries: Annotated[int, Spec("approaches before the robot gives up", minimum=1, maximum=100)] = 3
    drive: ControllerConfig = ControllerConfig()

    @property
    def data_sheet(self) -> DataSheet:
        """Of the robot."""
        return self.drive.data_sheet


class Arrival(NamedTuple):
    """Error that the robot will arrive with if nothing disturbs it."""

    y: float
    """[m]"""
    theta: float
    """[rad]"""


def pose_on_axis(distance: float, backward: bool) -> Pose:
    """Return the pose on the axis ``distance`` [m] before the docked one, in the dock's frame."""
    return Pose(distance if backward else -distance, 0.0, 0.0)


def axis_lyapunov(pose: Pose, length: float) -> float:
    """V on the axis, with lambda = ``length`` [m]."""
    lateral = pose.y / length
    return 0.5 * (lateral * lateral + pose.theta * pose.theta)


def along_axis(pose: Pose, v: float, length: float) -> Twist:
    """Return the command of speed ``v`` [m/s], < 0 for out, that keeps dV <= 0."""
    curvature = pose.y * sinc(pose.theta) / (length * length)
    return Twist(v, -v * curvature - 2.0 * abs(v) * pose.theta / length)


def hold_heading(pose: Pose, v: float, length: float) -> Twist:
    """Return the command of speed ``v`` [m/s] that holds the heading of the axis: theta^2 decays, y stays."""
    return Twist(v, -2.0 * abs(v) * pose.theta / length)


def arrival(pose: Pose, config: DockingConfig) -> Arrival:
    """Predict the error at contact from a pose in the dock's frame, linearised.

    Until ``commit_distance`` y'' + 2 y' / lambda + y / lambda^2 = 0 over the way, then theta' = -2 theta / lambda until
    ``straight_length``, then neither changes.
    """
    length, distance = config.approach_length, max(-pose.x, 0.0)
    straight = min(config.straight_length, distance)
    hold = max(min(config.commit_distance, distance) - straight, 0.0)
    way = max(distance - straight - hold, 0.0)
    slope, left = pose.y / length + pose.theta, math.exp(-way / length)
    y, theta = (pose.y + slope * way) * left, (pose.theta - slope * way / length) * left
    held = math.exp(-2.0 * hold / length)
    y, theta = y + 0.5 * length * theta * (1.0 - held), theta * held
    return Arrival(y + straight * theta, theta)


def fits(at: Arrival, share: float, config: DockingConfig) -> bool:
    """Whether an arrival is within this share of the tolerances."""
    return abs(at.y) <= share * config.dock_xy_tolerance and abs(at.theta) <= share * config.dock_yaw_tolerance


def is_certain(at: Arrival, distance: float, uncertainty: Uncertainty, config: DockingConfig) -> bool:
    """Whether an arrival fits together with the uncertainty of the pose, ``distance`` [m] before contact."""
    across = math.hypot(uncertainty.xy, distance * uncertainty.theta)
    return (
        abs(at.y) + _SIGMAS * across <= config.dock_xy_tolerance
        and abs(at.theta) + _SIGMAS * uncertainty.theta <= config.dock_yaw_tolerance
    )


def leading(pose: Pose, config: DockingConfig) -> Pose:
    """Return the pose of the end that leads: for a robot that docks backwards in the dock's frame turned round."""
    if not config.dock_backward:
        return pose
    return Pose(-pose.x, -pose.y, pose.theta)


def is_inside(pose: Pose, wider: float, config: DockingConfig) -> bool:
    """Whether a pose is in the corridor, the sublevel set of V, or in one wider by a factor."""
    return math.sqrt(2.0 * axis_lyapunov(pose, config.approach_length)) <= wider * config.corridor
