"""The filter of a robot in a loop of one's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diffbot.given import AnyPose, AnyRobot, pose_of, robot_of, with_parameters
from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurements import PoseFix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_core.units import NS_PER_S

_UNKNOWN = TwistCovariance(0.0, 0.0, 0.0)


class Filter:
    """Estimates a pose from odometry and from poses that come late, seldom and with noise.

    >>> import diffbot
    >>> ekf = diffbot.Filter("turtlebot4")
    >>> ekf.fix(0.0, (0.0, 0.0, 0.0), sigma=(0.05, 0.05))
    >>> for step in range(11):
    ...     pose = ekf.odometry(0.1 * step, v=0.2, omega=0.0)
    >>> round(pose.x, 3), ekf.sigma[0] < 0.1
    (0.2, True)
    """

    def __init__(self, robot: AnyRobot | None = None, **parameters: Any) -> None:
        """Take a robot's filter, or the default one.

        Args:
            robot: parameter file, name of one of ROBOTS, or description; None: the defaults of the node.
            parameters: by their names in docs/reference/parameters.

        Raises:
            DiffbotError: in one line, for a robot or a value that cannot be used.
        """
        node = EkfNodeConfig() if robot is None else robot_of(robot).ekf
        self.config = with_parameters(node, parameters)
        self._localization = Localization(self.config.localization, self.config.wheels.wheel_separation)

    def fix(self, time: float, pose: AnyPose, sigma: Sequence[float]) -> None:
        """Take a measured pose; it may be older than the newest odometry by ``history_length``.

        Args:
            time: [s] at which it was true.
            pose: in map.
            sigma: its standard deviations [m], [rad].

        Raises:
            BadMessageError: for one that is too old.
        """
        xy, theta = sigma
        R = np.diag((xy * xy, xy * xy, theta * theta))
        self._localization.on_measurement(PoseFix(round(time * NS_PER_S), pose_of("pose", pose), R))

    def odometry(self, time: float, v: float, omega: float, sigma: Sequence[float] | None = None) -> Pose:
        """Move by the mean velocity since the last odometry, and return the estimate.

        Args:
            time: [s] of the end of the motion, rising.
            v: [m/s]
            omega: [rad/s]
            sigma: standard deviations of both; None: by alpha1 to alpha4.

        Raises:
            BadMessageError: before the first fix, or out of order.
        """
        covariance = _UNKNOWN if sigma is None else TwistCovariance(sigma[0] ** 2, 0.0, sigma[1] ** 2)
        return self._localization.on_odometry(OdometryStep(round(time * NS_PER_S), Twist(v, omega), covariance)).pose

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(3, 3) of the estimate [m, m, rad]."""
        return np.array(self._localization.estimate().P)

    @property
    def sigma(self) -> tuple[float, float]:
        """Standard deviations of the estimate [m], [rad]."""
        found = uncertainty_of(self._localization.estimate().P)
        return found.xy, found.theta
