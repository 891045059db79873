"""Adversaries of the default law in Omega_L: noise within the contract that carries the robot away from the goal.

One sends the robot to and fro between the ends of the position error, each way with the heading error that shifts it
aside: a hundredth of a millimetre in a step, as long as the switch allows. The robot never seems to rest, so the finish
does not begin. The other one shows the robot at rest with the largest lateral error that does not count as outside,
until a V begins, and then less far out than it is. What they reach is a lower bound of any certified distance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from diffbot_control.law.configuration import ControllerMemory, new_memory
from diffbot_control.law.controller import step
from diffbot_control.law.finish import V_LEG
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, Switching
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.maker.near import resting_radius
from diffbot_lab.stability.runs import SIGMA_THETA, ContractLoop
from diffbot_sim.model.plant import integrate

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
_OUT = (0.8, 0.9, 1.0)
"""shares of the position error along the axis while a V goes out"""
_HAIR = 1e-4
"""[m] by which the robot is shown nearer than where it counts as outside"""

Errors = Callable[[Pose, ControllerMemory], Pose]
"""From the true pose to what is added to it: within the contract."""


class Drift(NamedTuple):
    """What the adversary achieved."""

    farthest: float
    """[m] distance from the goal"""
    time: float
    """[s] until then"""


def drift_of(loop: ContractLoop) -> Drift:
    """Return the farthest of both against a loop, from a few starts beside the goal."""
    leaving = resting_radius(loop.law, loop.contract.sigma_max)
    starts = (leaving + share * loop.contract.eps_position for share in _STARTS)
    drifts = [drift(loop, leaving, Pose(0.0, y, 0.0), _STEPS) for y in starts]
    return max(*drifts, *(lured_out(loop, leaving, share) for share in _OUT))


def drift(loop: ContractLoop, leaving: float, start: Pose, steps: int) -> Drift:
    """Send the robot to and fro until Omega_L is left.

    Args:
        loop: law, contract and period.
        leaving: [m] measured distance beyond which the switch counts.
        start: true pose in Omega_L, near the goal.
        steps: at most.
    """
    contract = loop.contract
    e_x, e_y = _ALONG * contract.eps_position, math.sqrt(1.0 - _ALONG**2) * contract.eps_position

    def errors(pose: Pose, memory: ControllerMemory) -> Pose:
        direction = math.copysign(1.0, memory.command.v)
        if direction * pose.x > _TURN_BACK * e_x:
            direction = -direction
        aside = 0.0 if pose.y < leaving - _AHEAD else -e_y
        return Pose(-direction * e_x, aside, -direction * contract.eps_theta)

    return _farthest(loop, start, steps, errors)


def lured_out(loop: ContractLoop, leaving: float, share: float) -> Drift:
    """Let a V begin with the largest lateral error, and show the robot nearer than it is, until Omega_L is left.

    Args:
        loop: law, contract and period.
        leaving: [m] measured distance beyond which the switch counts at rest.
        share: of the position error that is along the axis while the V goes out.
    """
    eps = loop.contract.eps_position
    out = Pose(share * eps, -math.sqrt(1.0 - share * share) * eps, loop.contract.eps_theta)

    def errors(_: Pose, memory: ControllerMemory) -> Pose:
        return out if memory.finish.kind == V_LEG else Pose(0.0, -eps, 0.0)

    start = Pose(0.0, leaving + eps - _HAIR, 0.0)
    return _farthest(loop, start, _STEPS, errors)


def _farthest(loop: ContractLoop, start: Pose, steps: int, errors: Errors) -> Drift:
    memory = new_memory()._replace(switching=Switching(OMEGA_L, 1, 0), command=_ARRIVING)
    uncertainty, pose = Uncertainty(loop.contract.sigma_max, SIGMA_THETA), start
    farthest, when = math.hypot(start.x, start.y), 0.0
    for number in range(steps):
        e_x, e_y, e_theta = errors(pose, memory) if memory.switching.region == OMEGA_L else _GOAL
        seen = Estimate(Pose(pose.x + e_x, pose.y + e_y, pose.theta + e_theta), uncertainty)
        memory, command, _ = step(memory, seen, _GOAL, loop.period, loop.law)
        pose = integrate(pose, command, loop.period, exact_arc=True)
        distance = math.hypot(pose.x, pose.y)
        if distance > farthest:
            farthest, when = distance, (number + 1) * loop.period
        if number > 0 and memory.switching.region == OMEGA_G:
            break
    return Drift(farthest, when)
