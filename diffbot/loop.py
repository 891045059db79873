"""Controller and filter of a robot in a loop of one's own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from diffbot.given import AnyPose, AnyRobot, goal_of, pose_of, robot_of, sigma_of, time_of, with_parameters
from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurement import pose_fix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.goals import GoalRequest, Supervisor
from diffbot_control.ros.parameters.controller import ControllerNodeConfig, law_of
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_core.stamps import NS_PER_S
from diffbot_core.uncertainty import Uncertainty

_LEAST_SIGMA = 1e-9
"""of a fix: without any uncertainty its covariance is singular"""


class Controller(Supervisor):
    """Answers each pose with a command, and each goal with how it ended.

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
        """Take a robot's controller, or the default one, with some parameters changed.

        Args:
            robot: parameter file, name of one of ROBOTS, or :func:`robot`; None: the defaults of the node.
            parameters: by their names in docs/reference/parameters, with ``_`` for the dots.

        Raises:
            DiffbotError: in one line, for a robot or a value that cannot be used.
        """
        node = ControllerNodeConfig() if robot is None else robot_of(robot).controller
        super().__init__(with_parameters(node.supervisor, parameters), law_of(node.law))
        self._time = -math.inf

    def go_to(self, goal: AnyPose) -> None:
        """Drive to ``goal`` from the next pose on; it replaces the present one. ``on_cancel()`` drops it.

        Raises:
            InvalidValueError: for a goal that is not three numbers.
        """
        self.on_goal(goal_of("goal", goal), GoalRequest(source="go_to"))

    def step(self, time: float, pose: AnyPose, sigma: Sequence[float] = (0.0, 0.0)) -> Twist:
        """Answer a pose with the command until the next one; zero without a goal.

        Args:
            time: [s] of the pose, rising.
            pose: estimate in the frame of the goal.
            sigma: its standard deviations [m], [rad]; zero: exact.

        Raises:
            InvalidValueError: for a time that does not rise, a pose or a sigma that cannot be used.
        """
        at, uncertainty = pose_of("pose", pose), sigma_of(sigma)
        self._time = time_of(time, self._time)
        return self.on_pose(round(time * NS_PER_S), self._time, at, uncertainty) or Twist(0.0, 0.0)

    @property
    def end(self) -> str:
        """How the newest goal ended: reached, not reached, cancelled ...; empty while it is driven to."""
        return self.goals.ended[-1].end if self.goals.present is None and self.goals.ended else ""


class Filter(Localization):
    """Estimates a pose from odometry and from poses that come late, seldom and with noise.

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
        """Take a robot's filter, or the default one, with some parameters changed; see :class:`Controller`.

        Raises:
            DiffbotError: in one line, for a robot or a value that cannot be used.
        """
        node = with_parameters(EkfNodeConfig() if robot is None else robot_of(robot).ekf, parameters)
        super().__init__(node.localization, node.wheels.wheel_separation)

    def fix(self, time: float, pose: AnyPose, sigma: Sequence[float]) -> None:
        """Take a measured pose; it may be older than the newest odometry by ``history_length``.

        Args:
            time: [s] at which it was true.
            pose: in map.
            sigma: its standard deviations [m], [rad].

        Raises:
            DiffbotError: for a fix that is too old, or a value that cannot be used.
        """
        xy, theta = sigma_of(sigma, _LEAST_SIGMA)
        R = np.diag(np.square((xy, xy, theta)))
        self.on_measurement(pose_fix(round(time_of(time) * NS_PER_S), pose_of("pose", pose), R))

    def odometry(self, time: float, v: float, omega: float, sigma: Sequence[float] = (0.0, 0.0)) -> Pose:
        """Move by the mean velocity since the last odometry, and return the estimate.

        Args:
            time: [s] of the end of the motion, rising.
            v: [m/s]
            omega: [rad/s]
            sigma: standard deviations of both; zero: by alpha1 to alpha3.

        Raises:
            DiffbotError: before the first fix, for a time that does not rise, or a sigma that cannot be used.
        """
        sigma_v, sigma_omega = sigma_of(sigma)
        covariance = TwistCovariance(sigma_v**2, 0.0, sigma_omega**2)
        return self.on_odometry(OdometryStep(round(time_of(time) * NS_PER_S), Twist(v, omega), covariance)).pose

    @property
    def sigma(self) -> Uncertainty:
        """Standard deviations of the estimate: xy [m], theta [rad]."""
        return uncertainty_of(self.estimate().P)
