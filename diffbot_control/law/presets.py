"""Named controllers: the default, and the paper's."""

from __future__ import annotations

from diffbot_control.law.controller import ControllerConfig
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.lyapunov_law import PAPER_GAINS
from diffbot_control.law.reapproach import ReapproachConfig
from diffbot_control.law.regions import COVARIANCE, FIXED, CovarianceRegionPolicy, RegionPolicy

TUNED, PAPER_COVARIANCE, PAPER = "tuned", "paper_covariance", "paper"
_PAPER_SIGMAS = CovarianceRegionPolicy(eps_P_sigmas=2.2)
_PAPER_REAPPROACH = ReapproachConfig(reapproach_share=0.7)
PRESETS: dict[str, ControllerConfig] = {
    TUNED: ControllerConfig(),
    PAPER_COVARIANCE: ControllerConfig(
        gains=PAPER_GAINS,
        region_policy=RegionPolicy(kind=COVARIANCE, covariance=_PAPER_SIGMAS),
        reapproach=_PAPER_REAPPROACH,
    ),
    PAPER: ControllerConfig(
        gains=PAPER_GAINS,
        region_policy=RegionPolicy(kind=FIXED, covariance=_PAPER_SIGMAS),
        reapproach=_PAPER_REAPPROACH,
        tolerance=GoalTolerance(xy_goal_tolerance=0.4),
    ),
}
"""``tuned``: the defaults; gains for a double pole, a region that follows the covariance, re-approach.
``paper_covariance``: the same with the paper's gains. ``paper``: gains and fixed region of the paper, and a wide
position tolerance, because its law with a fixed region leaves a lateral error of some 0.2 m."""
