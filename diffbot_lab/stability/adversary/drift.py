"""An adversary of the law with braking profiles: noise within the contract that carries the robot away from the goal.

In Omega_L the robot goes to and fro between the ends of the position error, each way with the heading error that
shifts it aside. It never seems to rest, so the finish does not begin; when it is as far aside as the switch allows, it
is made to rest, and the lateral error is shown larger than it is: the way out of the finish is as long as it can be.
What it reaches is a lower bound of any certified distance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.law.braking_step import braking_step
from diffbot_control.law.configuration import ControllerConfig, new_memory
from diffbot_control.law.finish import RESTING
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, Switching
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.tuned.contract import PLANT, Contract
from diffbot_sim.model.philox import Draw
from diffbot_sim.model.plant import new_plant, plant_step

_GOAL = Pose(0.0, 0.0, 0.0)
_TURN_BACK = 0.45
"""share of the error of x at which the robot is sent back: before the command becomes small"""
_AHEAD = 0.07
"""[m] before the leaving radius, from where on the lateral error is shown smaller"""
_ENOUGH = 0.85
"""share of the error of y beyond the leaving radius at which the finish is begun"""
_ARRIVING = Twist(0.1, 0.0)
"""the command before the first step: the time in which the finish may begin has not started"""
_SIGMA = Uncertainty(0.02, 0.01)


class Drift(NamedTuple):
    """What the adversary achieved."""

    farthest: float
    """[m] distance from the goal"""
    time: float
    """[s] until then"""


def drift(config: ControllerConfig, contract: Contract, start: Pose, steps: int) -> Drift:
    """Drive with the adversary's noise until Omega_L is left.

    Args:
        config: of the controller; without tries of the finish it is only carried aside.
        contract: of the estimate.
        start: true pose in Omega_L, near the goal.
        steps: at most.
    """
    e_xy, e_theta, leave = contract.eps_xy, contract.eps_theta, config.region_policy.covariance.eps_P_leave_min
    no_errors = Draw(0.0, 0.0, 0.0, 0.0)
    memory = new_memory()._replace(switching=Switching(OMEGA_L, 1, 0), command=_ARRIVING)
    state, direction, resting = new_plant(start), 1.0, False
    farthest, when = math.hypot(start.x, start.y), 0.0
    for step in range(steps):
        x, y, theta = state.pose
        if direction * x > _TURN_BACK * e_xy:
            direction = -direction
        resting = resting or (config.finish.finish_tries > 0 and y > leave + _ENOUGH * e_xy)
        ex, ey, e_heading = -direction * e_xy, (0.0 if y < leave - _AHEAD else -e_xy), -direction * e_theta
        if memory.switching.region == OMEGA_G or memory.finish.phase != RESTING:
            ex = ey = e_heading = 0.0
        elif resting:
            ex, e_heading = min(max(-x, -e_xy), e_xy), min(max(-theta, -e_theta), e_theta)
            begins = memory.finish.quiet_steps == config.tolerance.settling_steps - 1
            ey = e_xy if begins else -e_xy
        seen = Estimate(Pose(x + ex, y + ey, theta + e_heading), _SIGMA)
        memory, command, _ = braking_step(memory, seen, _GOAL, PLANT.sampling_time, config)
        state = plant_step(state, command, no_errors, PLANT)
        distance = math.hypot(state.pose.x, state.pose.y)
        if distance > farthest:
            farthest, when = distance, (step + 1) * PLANT.sampling_time
        if step > 0 and memory.switching.region == OMEGA_G:
            break
    return Drift(farthest, when)
