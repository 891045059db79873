"""Navigation variables of the paper, Eq. (2), and their discrete models, Eqs. (4) to (7)."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.geometry import Pose, wrap_angle

HALF_PI = 0.5 * math.pi


class Navigation(NamedTuple):
    """The goal relative to the robot."""

    rho: float
    """[m] distance of the goal"""
    alpha: float
    """[rad] bearing of the goal in the robot's frame, in (-pi, pi]"""
    beta: float
    """[rad] bearing of the goal in the goal's frame, in (-pi, pi]; the heading is theta = beta - alpha"""


def navigation_variables(pose: Pose) -> Navigation:
    """Eq. (2) for a pose given in the goal's frame, i.e. with the goal at (0, 0, 0).

    At the goal itself (rho = 0) beta is 0, so alpha is -theta.
    """
    # 0.0 - x, not -x: atan2(-0.0, -0.0) is -pi, and beta at the goal would flip.
    dx = 0.0 - pose.x
    dy = 0.0 - pose.y
    beta = wrap_angle(math.atan2(dy, dx))
    return Navigation(math.hypot(dx, dy), wrap_angle(beta - pose.theta), beta)


def in_front(alpha: float) -> bool:
    """Whether the goal is in the front sector, alpha in (-pi/2, pi/2].

    Eq. (4) excludes pi/2 and Eq. (6) includes it; (6) is followed.
    """
    return -HALF_PI < alpha <= HALF_PI
