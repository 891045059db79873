"""Controller and filter of a robot, for use in your own loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from diffbot.arguments import (
    AnyPose,
    AnyRobot,
    goal_of,
    number_of,
    pose_of,
    robot_of,
    sigma_of,
    time_of,
    with_parameters,
)
from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurement import pose_fix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.goals import GoalRequest, Supervisor
from diffbot_control.law.registry import resolve_law
from diffbot_control.ros.messages.fields import MAX_SPEED
from diffbot_control.ros.parameters.controller import ControllerNodeConfig
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_core.stamps import NS_PER_S
from diffbot_core.uncertainty import Uncertainty

_MIN_SIGMA = 1e-9
"""Smallest standard deviation of a fix, since the covariance of an exact fix would be singular."""


class Controller(Supervisor):
    """Controller of a robot: returns a command for each pose, and reports how each goal ended.

    Examples:
        >>> import diffbot
        >>> controller = diffbot.Controller(linear_x_max_velocity=0.5, linear_x_max_acceleration=1.0)
        >>> controller.go_to((2.0, 0.0, 0.0))
        >>> controller.step(0.0, (0.0, 0.0, 0.0)), controller.step(0.1, (0.0, 0.0, 0.0)).v <= 0.1
        (Twist(v=0.0, omega=0.0), True)
        >>> controller.status, controller.end
        ('driving', '')
    """

    def __init__(self, robot: AnyRobot | None = None, **parameters: Any) -> None:
        """Create the controller of a robot with some parameters changed.

        Args:
            robot: parameter file, name in ROBOTS, or result of :func:`robot`. None uses the defaults of the node.
            parameters: new values by the names in docs/reference/parameters, with ``_`` in place of dots.

        Raises:
            DiffbotError: if the robot is unknown or a value is not allowed.
        """
        node = ControllerNodeConfig() if robot is None else robot_of(robot).controller
        super().__init__(with_parameters(node.supervisor, parameters), resolve_law(node.law))
        self._time = -math.inf

    def go_to(self, goal: AnyPose) -> None:
        """Start to drive to ``goal``, which replaces the current goal. ``on_cancel()`` cancels the goal.

        Raises:
            InvalidValueError: if the goal is not three finite numbers, or its heading seems to be in degrees.
        """
        self.on_goal(goal_of("goal", goal), GoalRequest(source="go_to"))

    def step(self, time: float, pose: AnyPose, sigma: Sequence[float] = (0.0, 0.0)) -> Twist:
        """Return the command for a pose. The command is zero without a goal.

        Args:
            time: [s] time of the pose, later than the time of the previous pose.
            pose: estimated pose in the frame of the goal.
            sigma: standard deviations of the pose [m], [rad]; zero if the pose is exact.

        Raises:
            InvalidValueError: if an argument is not finite, or ``time`` is not later than the previous time.
        """
        at, uncertainty = pose_of("pose", pose), sigma_of(sigma)
        self._time = time_of(time, self._time)
        return self.on_pose(round(self._time * NS_PER_S), self._time, at, uncertainty) or Twist(0.0, 0.0)

    @property
    def end(self) -> str:
        """How the newest goal ended, such as "reached", "not reached" or "cancelled"; empty while it is active."""
        return self.goals.ended[-1].end if self.goals.present is None and self.goals.ended else ""


class Filter(Localization):
    """Filter of a robot: estimates its pose from odometry and from noisy fixes, which may be late and rare.

    Examples:
        >>> import diffbot
        >>> ekf = diffbot.Filter("turtlebot4")
        >>> ekf.fix(0.0, (0.0, 0.0, 0.0), sigma=(0.05, 0.05))
        >>> for step in range(11):
        ...     pose = ekf.odometry(0.1 * step, v=0.2, omega=0.0)
        >>> round(pose.x, 3), ekf.sigma.xy < 0.1
        (0.2, True)
    """

    def __init__(self, robot: AnyRobot | None = None, **parameters: Any) -> None:
        """Create the filter of a robot with some parameters changed; arguments as for :class:`Controller`.

        Raises:
            DiffbotError: if the robot is unknown or a value is not allowed.
        """
        node = with_parameters(EkfNodeConfig() if robot is None else robot_of(robot).ekf, parameters)
        super().__init__(node.localization, node.wheels.wheel_separation)

    def fix(self, time: float, pose: AnyPose, sigma: Sequence[float]) -> None:
        """Add a measured pose, which may be older than the newest odometry by up to ``history_length``.

        Args:
            time: [s] time of the measurement.
            pose: measured pose in map.
            sigma: standard deviations of the pose [m], [rad].

        Raises:
            DiffbotError: if the fix is too old, or an argument is not allowed.
        """
        xy, theta = sigma_of(sigma, _MIN_SIGMA)
        R = np.diag(np.square((xy, xy, theta)))
        self.on_measurement(pose_fix(round(time_of(time) * NS_PER_S), pose_of("pose", pose), R))

    def odometry(self, time: float, v: float, omega: float, sigma: Sequence[float] = (0.0, 0.0)) -> Pose:
        """Add the mean velocity since the previous odometry, and return the estimated pose.

        Args:
            time: [s] time of the odometry, later than the time of the previous odometry.
            v: [m/s]
            omega: [rad/s]
            sigma: standard deviations of ``v`` [m/s] and ``omega`` [rad/s]; if one is 0, alpha1 to alpha3 define them.

        Raises:
            DiffbotError: before the first fix, or if an argument is not allowed.
        """
        twist = Twist(number_of("v", v, MAX_SPEED, "m/s"), number_of("omega", omega, MAX_SPEED, "rad/s"))
        sigma_v, sigma_omega = sigma_of(sigma)
        # As in a message, one zero makes both deviations unknown.
        is_known = sigma_v > 0.0 and sigma_omega > 0.0
        covariance = TwistCovariance(sigma_v**2, 0.0, sigma_omega**2) if is_known else TwistCovariance(0.0, 0.0, 0.0)
        return self.on_odometry(OdometryStep(round(time_of(time) * NS_PER_S), twist, covariance)).pose

    @property
    def sigma(self) -> Uncertainty:
        """Standard deviations of the estimate: ``xy`` [m] and ``theta`` [rad]."""
        return uncertainty_of(self.estimate().P)
