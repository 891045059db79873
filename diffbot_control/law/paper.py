"""The law of the paper: (13) in Omega_G and (17) in Omega_L, with a tanh profile and a fixed region.

    Omega_G:  v = gamma tanh(rho) cos(alpha)
              omega = k alpha + gamma sinc(alpha) (tanh(rho) / rho) cos(alpha) (alpha + h beta)            Eq. (13)
    Omega_L:  v = gamma tanh(rho) cos(alpha),  omega = -k_2 theta                                          Eq. (17)

The velocity along the robot's real axis has the same sign in *both* sectors. The paper prints a minus sign for the rear
sector, because it reverses the forward direction there ("v := -v"). With the kinematics (3), this sign would literally
drive the robot away from a goal behind it. See docs/explanation/law.md. The limits keep the curvature of the path.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.law.configuration import PaperConfig, PaperGains
from diffbot_control.law.goal_checker import Settling, next_settling, within
from diffbot_control.law.law import Law, Observation, Report
from diffbot_control.law.limits import limit_acceleration, limit_velocity
from diffbot_control.law.regions import OMEGA_G, OMEGA_L
from diffbot_control.law.steering import Navigation, local_lyapunov, navigation_variables, sinc
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import Twist

_SERIES = 1e-4
"""[m] below this distance tanh(rho) / rho is computed from its series, which is exact to the last bit there"""


class PaperMemory(NamedTuple):
    """State of the law between two steps."""

    region: int
    command: Twist
    """the last command"""
    settling: Settling
    reached: bool


def tanhc(rho: float) -> float:
    """Return tanh(rho) / rho, which is 1 at 0."""
    if abs(rho) < _SERIES:
        return 1.0 - rho * rho / 3.0
    return math.tanh(rho) / rho


def _velocity(navigation: Navigation, gains: PaperGains) -> float:
    """Return the velocity [m/s] along the robot's real axis for both regions and both sectors; |v| <= gamma."""
    return gains.gamma * math.tanh(navigation.rho) * math.cos(navigation.alpha)


def global_law(navigation: Navigation, gains: PaperGains) -> Twist:
    """Return the command of law (13) for Omega_G: drive and steer."""
    rho, alpha, beta = navigation
    turn = gains.gamma * sinc(alpha) * tanhc(rho) * math.cos(alpha)
    return Twist(_velocity(navigation, gains), gains.k * alpha + turn * (alpha + gains.h * beta))


def local_law(navigation: Navigation, theta: float, gains: PaperGains) -> Twist:
    """Return the command of law (17) for Omega_L: drive and hold the heading theta [rad] in the goal's frame at 0."""
    return Twist(_velocity(navigation, gains), -gains.k_2 * theta)


def global_lyapunov(navigation: Navigation, gains: PaperGains) -> float:
    """Return V of Omega_G, Eq. (8): (rho^2 + alpha^2 + h beta^2) / 2."""
    rho, alpha, beta = navigation
    return 0.5 * (rho * rho + alpha * alpha + gains.h * beta * beta)


def new_paper_memory() -> PaperMemory:
    """Return the memory at rest with a new goal."""
    return PaperMemory(OMEGA_G, Twist(0.0, 0.0), Settling(0, False), False)


def paper_step(
    memory: PaperMemory, observation: Observation, goal: Pose, config: PaperConfig
) -> tuple[PaperMemory, Twist, Report]:
    """Drive towards ``goal`` for one period, within the limits; see :meth:`Law.step`."""
    tolerance, gains, sheet = config.tolerance, config.gains, config.data_sheet
    local = into_frame(observation.estimate.pose, goal)
    navigation = navigation_variables(local)
    rho, alpha, beta = navigation
    is_near = rho <= config.eps_P_leave if memory.region == OMEGA_L else rho < config.eps_P
    if is_near:
        region, radius = OMEGA_L, config.eps_P_leave
        requested, lyapunov = local_law(navigation, local.theta, gains), local_lyapunov(navigation, local.theta)
    else:
        region, radius = OMEGA_G, config.eps_P
        requested, lyapunov = global_law(navigation, gains), global_lyapunov(navigation, gains)
    if not config.allow_backward and requested.v < 0.0:
        # Do not reverse. In Omega_G, turn towards the goal on the spot: dV = -k alpha^2 <= 0.
        requested = Twist(0.0, gains.k * alpha if region == OMEGA_G else requested.omega)
    command = limit_acceleration(limit_velocity(requested, sheet), memory.command, observation.dt, sheet)
    if not (math.isfinite(command.v) and math.isfinite(command.omega)):
        command = Twist(0.0, 0.0)
    inside = within(local, rho, command, tolerance, sheet, observation.estimate.uncertainty)
    settling = next_settling(memory.settling, inside, tolerance)
    report = Report(rho, alpha, beta, local.theta, radius, region, lyapunov)
    return PaperMemory(region, command, settling, settling.reached), command, report


class PaperLaw(Law):
    """The law of the paper."""

    name = "paper"
    Config = PaperConfig
    step = staticmethod(paper_step)

    @staticmethod
    def new_memory(config: Any) -> PaperMemory:
        """Return the memory at rest with a new goal."""
        return new_paper_memory()

    @classmethod
    def memory_for_new_goal(cls, memory: Any, config: Any) -> PaperMemory:
        """Return a new memory with the current motion, for the limits of acceleration."""
        return new_paper_memory()._replace(command=memory.command)

    @staticmethod
    def after_command(memory: Any, command: Twist, dt: float, config: Any) -> PaperMemory:
        """Store the new command, and restart the count of consecutive poses within the tolerances."""
        after: PaperMemory = memory._replace(command=command)
        return after._replace(settling=after.settling._replace(steps_within=0))
