"""The filter of a robot in a loop of one's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from diffbot.given import AnyPose, AnyRobot, pose_of, robot_of, with_parameters
from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurements import PoseFix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_core.uncertainty import Uncertainty
from diffbot_core.units import NS_PER_S


class Filter(Localization):
    """Estimates a pose from odometry and from poses that come late, seldom and with noise.

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
            BadMessageError: for one that is too old.
        """
        R = np.diag(np.square((sigma[0], sigma[0], sigma[1])))
        self.on_measurement(PoseFix(round(time * NS_PER_S), pose_of("pose", pose), R))

    def odometry(self, time: float, v: float, omega: float, sigma: Sequence[float] = (0.0, 0.0)) -> Pose:
        """Move by the mean velocity since the last odometry, and return the estimate.

        Args:
            time: [s] of the end of the motion, rising.
            v: [m/s]
            omega: [rad/s]
            sigma: standard deviations of both; zero: by alpha1 to alpha4.

        Raises:
            BadMessageError: before the first fix, or out of order.
        """
        covariance = TwistCovariance(sigma[0] ** 2, 0.0, sigma[1] ** 2)
        return self.on_odometry(OdometryStep(round(time * NS_PER_S), Twist(v, omega), covariance)).pose

    @property
    def sigma(self) -> Uncertainty:
        """Standard deviations of the estimate: xy [m], theta [rad]."""
        return uncertainty_of(self.estimate().P)
