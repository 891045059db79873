"""Named controllers: the default, a precise one, and the paper's."""

from __future__ import annotations

from diffbot_control.law.configuration import TANH, ControllerConfig
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.lyapunov_law import PAPER_GAINS
from diffbot_control.law.regions import COVARIANCE, FIXED, CovarianceRegionPolicy, RegionPolicy
from diffbot_core.data_sheet import PAPER_DATA_SHEET

TUNED, PRECISE, PAPER_COVARIANCE, PAPER = "tuned", "precise", "paper_covariance", "paper"
_PAPER_SIGMAS = CovarianceRegionPolicy(eps_P_sigmas=2.2, eps_P_leave_factor=3.0, eps_P_leave_min=0.3)
PRESETS: dict[str, ControllerConfig] = {
    TUNED: ControllerConfig(),
    PRECISE: ControllerConfig(tolerance=GoalTolerance(xy_goal_tolerance=0.03)),
    PAPER_COVARIANCE: ControllerConfig(
        profile=TANH,
        gains=PAPER_GAINS,
        region_policy=RegionPolicy(kind=COVARIANCE, covariance=_PAPER_SIGMAS),
        data_sheet=PAPER_DATA_SHEET,
    ),
    PAPER: ControllerConfig(
        profile=TANH,
        gains=PAPER_GAINS,
        region_policy=RegionPolicy(kind=FIXED, covariance=_PAPER_SIGMAS),
        data_sheet=PAPER_DATA_SHEET,
        tolerance=GoalTolerance(xy_goal_tolerance=0.4),
    ),
}
"""``tuned``: the defaults; braking profiles, a region that follows the covariance, a finish at rest. ``precise``:
the same with a position tolerance of 0.03 m. ``paper_covariance``: the paper's law
and gains with the region that follows the covariance. ``paper``: gains and fixed region of the paper, and a wide
position tolerance, because its law with a fixed region leaves a lateral error of some 0.2 m."""
