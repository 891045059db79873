"""Ready-made controllers: the paper's, and the one that is used unless asked otherwise."""

from __future__ import annotations

from diffbot_control.law.controller import ControllerConfig
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.lyapunov_law import PAPER_GAINS, TUNED_GAINS
from diffbot_control.law.reapproach import ReapproachConfig
from diffbot_control.law.regions import CovarianceRegion

TUNED, PAPER_COVARIANCE, PAPER = "tuned", "paper_covariance", "paper"
_NARROW = GoalTolerance(xy_goal_tolerance=0.1, yaw_goal_tolerance=0.1)
PRESETS: dict[str, ControllerConfig] = {
    TUNED: ControllerConfig(
        gains=TUNED_GAINS,
        covariance_region=CovarianceRegion(follow_covariance=True, eps_P_sigmas=2.15),
        reapproach=ReapproachConfig(reapproach_share=0.75),
        tolerance=_NARROW,
    ),
    PAPER_COVARIANCE: ControllerConfig(
        gains=PAPER_GAINS, covariance_region=CovarianceRegion(follow_covariance=True), tolerance=_NARROW
    ),
    PAPER: ControllerConfig(gains=PAPER_GAINS),
}
"""``tuned``: gains for a double pole, a region that follows the covariance, re-approach. ``paper_covariance``: the same
with the paper's gains. ``paper``: gains and fixed region of the paper, and the wide tolerance that its lateral error
needs."""
