"""One step of the loop by the project's own law and plant, and V before and after it."""

from __future__ import annotations

import math

from diffbot_control.law.lyapunov_law import Gains, global_law, global_lyapunov
from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_lab.stability.level.problem import LevelProblem, Witness
from diffbot_sim.model.plant import integrate

MARGIN = 1e-9
"""Rise of V that counts: a million times the rounding of the simulated step."""


def levels(witness: Witness, problem: LevelProblem) -> tuple[float, float]:
    """Simulate one step; return V, Eq. (8), before and after it."""
    gains = Gains(problem.gamma, problem.k, problem.h, 1.0)
    x, y = -witness.rho * math.cos(witness.beta), -witness.rho * math.sin(witness.beta)
    pose = Pose(x, y, wrap_angle(witness.beta - witness.alpha))
    heading = wrap_angle(pose.theta + witness.eps_theta)
    measured = navigation_variables(Pose(x + witness.eps_x, y + witness.eps_y, heading))
    v, omega = global_law(measured, gains)
    after = integrate(pose, Twist(v + witness.eps_v, omega + witness.eps_omega), problem.t_s, problem.exact_arc)
    before = global_lyapunov(navigation_variables(pose), gains)
    return before, global_lyapunov(navigation_variables(after), gains)
