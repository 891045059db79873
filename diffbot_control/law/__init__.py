"""The switching Lyapunov law, its regions, limits and goal checker as pure functions of floats.

One step of the controller, with its memory as argument and result::

    from diffbot_control.law import PRESETS, ControllerMemory, step
    from diffbot_core import Estimate, Uncertainty

    estimate = Estimate(pose, Uncertainty(0.02, 0.01))
    memory, command, report = step(ControllerMemory(), estimate, goal, 0.1, PRESETS["tuned"])

:mod:`diffbot_control.goals` adds goals, paths and timeouts. Nothing here needs more than ``math``.
"""

from diffbot_control.law.controller import (
    ControllerConfig,
    ControllerMemory,
    Driving,
    Report,
    SwitchingLaw,
    step,
    stop_step,
)
from diffbot_control.law.finish import Finish, FinishConfig
from diffbot_control.law.goal_checker import GoalTolerance, Settling, is_knowable, within
from diffbot_control.law.latency import coast
from diffbot_control.law.limits import limit_acceleration, limit_change, limit_velocity
from diffbot_control.law.lyapunov_law import (
    PAPER_GAINS,
    Gains,
    global_law,
    global_lyapunov,
    local_law,
    local_lyapunov,
)
from diffbot_control.law.paper.reapproach import Reapproach, ReapproachConfig
from diffbot_control.law.polar_coordinates import Navigation, navigation_variables
from diffbot_control.law.presets import PAPER, PAPER_COVARIANCE, PRECISE, PRESETS, TUNED
from diffbot_control.law.regions import (
    COVARIANCE,
    FIXED,
    OMEGA_G,
    OMEGA_L,
    CovarianceRegionPolicy,
    FixedRegionPolicy,
    RegionPolicy,
    Switching,
    smallest_radius,
)
from diffbot_control.law.speed_profile import ProfileGains, auto_gains
from diffbot_control.law.steering import Course

__all__ = [
    "COVARIANCE",
    "FIXED",
    "OMEGA_G",
    "OMEGA_L",
    "PAPER",
    "PAPER_COVARIANCE",
    "PAPER_GAINS",
    "PRECISE",
    "PRESETS",
    "TUNED",
    "ControllerConfig",
    "ControllerMemory",
    "Course",
    "CovarianceRegionPolicy",
    "Driving",
    "Finish",
    "FinishConfig",
    "FixedRegionPolicy",
    "Gains",
    "GoalTolerance",
    "Navigation",
    "ProfileGains",
    "Reapproach",
    "ReapproachConfig",
    "RegionPolicy",
    "Report",
    "Settling",
    "Switching",
    "SwitchingLaw",
    "auto_gains",
    "coast",
    "global_law",
    "global_lyapunov",
    "is_knowable",
    "limit_acceleration",
    "limit_change",
    "limit_velocity",
    "local_law",
    "local_lyapunov",
    "navigation_variables",
    "smallest_radius",
    "step",
    "stop_step",
    "within",
]
