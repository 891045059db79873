"""The control laws, their regions, limits and goal checker, as pure functions of floats.

One step of this project's law, with its memory as argument and result::

    from diffbot_control.law import CONTACT_UNKNOWN, Observation, SwitchingConfig, new_memory, step
    from diffbot_core.uncertainty import Estimate, Uncertainty

    estimate = Estimate(pose, Uncertainty(0.02, 0.01))
    observation = Observation(estimate, 0.1, 0.1, CONTACT_UNKNOWN)
    memory, command, report = step(new_memory(), observation, goal, SwitchingConfig())

:mod:`diffbot_control.goals` adds goals, paths and timeouts. The laws use only the module ``math``.
"""

from diffbot_control.law.configuration import PaperConfig, PaperGains, SwitchingConfig
from diffbot_control.law.goal_checker import GoalTolerance, within
from diffbot_control.law.latency import coast
from diffbot_control.law.law import CONTACT, CONTACT_UNKNOWN, NO_CONTACT, Law, Observation, Report
from diffbot_control.law.limits import limit_acceleration, limit_change, limit_velocity
from diffbot_control.law.paper import PaperLaw
from diffbot_control.law.regions import OMEGA_G, OMEGA_L
from diffbot_control.law.registry import PRESETS
from diffbot_control.law.steering import Navigation, navigation_variables
from diffbot_control.law.switching import SwitchingLaw, new_memory, step

__all__ = [
    "CONTACT",
    "CONTACT_UNKNOWN",
    "NO_CONTACT",
    "OMEGA_G",
    "OMEGA_L",
    "PRESETS",
    "GoalTolerance",
    "Law",
    "Navigation",
    "Observation",
    "PaperConfig",
    "PaperGains",
    "PaperLaw",
    "Report",
    "SwitchingConfig",
    "SwitchingLaw",
    "coast",
    "limit_acceleration",
    "limit_change",
    "limit_velocity",
    "navigation_variables",
    "new_memory",
    "step",
    "within",
]
