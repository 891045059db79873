"""An adversary of the default law in Omega_L: noise within the contract that carries the robot aside.

The robot goes to and fro between the ends of the position error, each way with the heading error that shifts it aside:
a hundredth of a millimetre in a step, as long as the switch allows. It never seems to rest, so the finish does not
begin. What it reaches is a lower bound of any certified distance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.law.braking_step import braking_step
from diffbot_control.law.configuration import ControllerConfig, new_memory
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, Switching
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.tuned.contract import PLANT, Contract
from diffbot_lab.stability.tuned.file import Certificate
from diffbot_lab.stability.tuned.near import leaving_radius
from diffbot_sim.model.philox import Draw
from diffbot_sim.model.plant import new_plant, plant_step

_GOAL = Pose(0.0, 0.0, 0.0)
_ALONG = 0.4
"""share of the position error along the axis; what remains of the disc is lateral"""
_TURN_BACK = 0.45
"""share of the error of x at which the robot is sent back: before the command becomes small"""
_AHEAD = 0.07
"""[m] before the leaving radius, from where on the lateral error is shown smaller"""
_ARRIVING = Twist(0.1, 0.0)
"""the command before the first step: the time in which the finish may begin has not started"""
_STARTS, _STEPS = (0.0, 0.4, 0.7, 0.85), 6000
"""lateral errors beyond the leaving radius, as shares of the position error, and steps of a drift"""
_SIGMA = Uncertainty(0.02, 0.01)


class Drift(NamedTuple):
    """What the adversary achieved."""

    farthest: float
    """[m] distance from the goal"""
    time: float
    """[s] until then"""


def drift_of(certificate: Certificate) -> Drift:
    """Return the farthest drift against the loop of a certificate, from a few starts beside the goal."""
    config, contract = certificate.config, certificate.plan.contract
    leaving = leaving_radius(config, contract.sigma_max)
    starts = (leaving + share * contract.eps_position for share in _STARTS)
    return max(drift(config, contract, leaving, Pose(0.0, y, 0.0), _STEPS) for y in starts)


def drift(config: ControllerConfig, contract: Contract, leaving: float, start: Pose, steps: int) -> Drift:
    """Drive with the adversary's noise until Omega_L is left.

    Args:
        config: of the controller.
        contract: of the estimate.
        leaving: [m] measured distance beyond which the switch counts.
        start: true pose in Omega_L, near the goal.
        steps: at most.
    """
    e_theta = contract.eps_theta
    e_x, e_y = _ALONG * contract.eps_position, math.sqrt(1.0 - _ALONG**2) * contract.eps_position
    no_errors = Draw(0.0, 0.0, 0.0, 0.0)
    memory = new_memory()._replace(switching=Switching(OMEGA_L, 1, 0), command=_ARRIVING)
    state, direction = new_plant(start), 1.0
    farthest, when = math.hypot(start.x, start.y), 0.0
    for step in range(steps):
        x, y, theta = state.pose
        if direction * x > _TURN_BACK * e_x:
            direction = -direction
        ex, ey, e_heading = -direction * e_x, (0.0 if y < leaving - _AHEAD else -e_y), -direction * e_theta
        if memory.switching.region == OMEGA_G:
            ex = ey = e_heading = 0.0
        seen = Estimate(Pose(x + ex, y + ey, theta + e_heading), _SIGMA)
        memory, command, _ = braking_step(memory, seen, _GOAL, PLANT.sampling_time, config)
        state = plant_step(state, command, no_errors, PLANT)
        distance = math.hypot(state.pose.x, state.pose.y)
        if distance > farthest:
            farthest, when = distance, (step + 1) * PLANT.sampling_time
        if step > 0 and memory.switching.region == OMEGA_G:
            break
    return Drift(farthest, when)
