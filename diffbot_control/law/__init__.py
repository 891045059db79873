"""The switching Lyapunov law, its regions, limits and goal checker as pure functions of floats, and the supervisor.

One step of the controller, with its memory as argument and result::

    from diffbot_control.law import PRESETS, ControllerConfig, ControllerMemory, step

    memory, command, report = step(ControllerMemory(), pose, goal, 0.1, ControllerConfig())

:class:`Supervisor` adds goals, paths and timeouts. Nothing here needs more than ``math``.
"""

from diffbot_control.law.controller import (
    ControllerConfig,
    ControllerMemory,
    Driving,
    Report,
    memory_for_new_goal,
    step,
    stop_step,
)
from diffbot_control.law.goal_checker import GoalTolerance, Settling, is_knowable, within
from diffbot_control.law.limits import Limits, limit_acceleration, limit_velocity
from diffbot_control.law.lyapunov_law import (
    PAPER_GAINS,
    Gains,
    global_law,
    global_lyapunov,
    local_law,
    local_lyapunov,
    sampled_poles,
    unstable_gains,
)
from diffbot_control.law.polar_coordinates import Navigation, navigation_variables
from diffbot_control.law.presets import PAPER, PAPER_COVARIANCE, PRESETS, TUNED
from diffbot_control.law.reapproach import Reapproach, ReapproachConfig
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
from diffbot_control.law.supervisor import Supervisor, SupervisorConfig

__all__ = [
    "COVARIANCE",
    "FIXED",
    "OMEGA_G",
    "OMEGA_L",
    "PAPER",
    "PAPER_COVARIANCE",
    "PAPER_GAINS",
    "PRESETS",
    "TUNED",
    "ControllerConfig",
    "ControllerMemory",
    "CovarianceRegionPolicy",
    "Driving",
    "FixedRegionPolicy",
    "Gains",
    "GoalTolerance",
    "Limits",
    "Navigation",
    "Reapproach",
    "ReapproachConfig",
    "RegionPolicy",
    "Report",
    "Settling",
    "Supervisor",
    "SupervisorConfig",
    "Switching",
    "global_law",
    "global_lyapunov",
    "is_knowable",
    "limit_acceleration",
    "limit_velocity",
    "local_law",
    "local_lyapunov",
    "memory_for_new_goal",
    "navigation_variables",
    "sampled_poles",
    "smallest_radius",
    "step",
    "stop_step",
    "unstable_gains",
    "within",
]
