"""Peer laws for going to a pose, to be measured in the arena of this project's own; pure functions of floats.

Each gets the pose in the goal's frame and answers with a twist. What is not part of a published law but of its use is
the same for all but one: the goal counts as reached within ``xy_goal_tolerance`` and ``yaw_goal_tolerance`` of the
estimate, and from then on the robot holds still, as Nav2's controller server has it with a stateful goal checker.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.law.lyapunov_law import PAPER_GAINS, Gains, global_law
from diffbot_control.law.polar_coordinates import HALF_PI, in_front, navigation_variables
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist

OURS, GRACEFUL_POSE, GRACEFUL, GRACEFUL_SHIPPED, POLAR, POLAR_FAST, AICARDI, AICARDI_ENDLESS = 0, 1, 2, 3, 4, 5, 6, 7
"""Codes of ``closed_loop.Case.peer``; 0 is this project's controller."""
_NEAR = 1e-9
"""[m] below it a curvature 1 / r is taken at this distance"""


class PeerMemory(NamedTuple):
    """What one step of a peer leaves to the next; the default is the state at a new goal."""

    turned: bool = False
    """the initial rotation is over"""
    arrived: bool = False
    """the position was within the tolerance once"""
    reached: bool = False
    """position and heading were"""
    direction: float = 0.0
    """1 forwards, -1 backwards, 0 not yet chosen"""


class StopTolerance(NamedTuple):
    """When a peer stops, by the estimate. Of 0.02, 0.03, 0.05 each law has the pair with which most runs succeed."""

    xy_goal_tolerance: float = 0.05
    """[m]"""
    yaw_goal_tolerance: float = 0.05
    """[rad]"""


class GracefulConfig(NamedTuple):
    """Parameters of Nav2's graceful controller under their names there; the defaults are Nav2's.

    Source: nav2_graceful_controller/src/parameter_handler.cpp, github.com/ros-navigation/navigation2.
    """

    v_linear_max: float = 0.5
    """[m/s]"""
    v_angular_max: float = 1.0
    """[rad/s]"""
    max_lookahead: float = 1.0
    """[m] the target is a point of the path so far ahead; inf: the goal itself"""
    prefer_final_rotation: bool = True
    """head straight for the target and turn to the goal's heading at the end"""
    initial_rotation: bool = True
    """turn in place first"""
    allow_backward: bool = False
    """drive backwards to a target behind"""
    initial_rotation_tolerance: float = 0.75
    """[rad] bearing of the target below which the initial rotation ends"""
    k_phi: float = 2.0
    """[-] k_1 of Park and Kuipers"""
    k_delta: float = 1.0
    """[-] k_2 of Park and Kuipers"""
    beta: float = 0.4
    """[m^lambda] weight of the curvature in the speed"""
    lambda_: float = 2.0
    """[-] exponent of the curvature in the speed"""
    v_linear_min: float = 0.1
    """[m/s]"""
    slowdown_radius: float = 1.5
    """[m] distance of the target below which the speed falls in proportion"""
    rotation_scaling_factor: float = 0.5
    """[-] of rotations in place"""
    v_angular_min_in_place: float = 0.25
    """[rad/s]"""
    stop: StopTolerance = StopTolerance()


class PolarConfig(NamedTuple):
    """Gains of the linear law in polar coordinates, in the signs of Siegwart and Nourbakhsh."""

    k_rho: float
    """[1/s] > 0"""
    k_alpha: float
    """[1/s] > k_rho"""
    k_beta: float
    """[1/s] < 0"""
    keep_direction: bool
    """drive forwards or backwards as the first pose has it; otherwise choose at each pose anew"""
    stop: StopTolerance = StopTolerance()


class AicardiConfig(NamedTuple):
    """Gains of law (13) without a region around the goal; the defaults are the paper's."""

    gains: Gains = PAPER_GAINS
    stop: StopTolerance = StopTolerance()


_TIGHT = StopTolerance(0.02, 0.02)
GRACEFUL_POSE_CONFIG = GracefulConfig(1.3, 2.6, math.inf, False, True, False, stop=_TIGHT)
"""The law as published, to the goal's pose, at this project's speed with v_angular_max in proportion."""
GRACEFUL_CONFIG = GracefulConfig(1.3, 2.6, math.inf, True, False, True, stop=_TIGHT)
"""The options of Nav2 that do best here at that speed: no path, backwards if the goal is behind, final rotation."""
GRACEFUL_SHIPPED_CONFIG = GracefulConfig(stop=_TIGHT)
SIEGWART_CONFIG = PolarConfig(3.0, 8.0, -1.5, True, StopTolerance(0.03, 0.05))
"""Gains of R. Siegwart and I. R. Nourbakhsh, Introduction to Autonomous Mobile Robots, MIT Press, section 3.6.2."""
PYTHON_ROBOTICS_CONFIG = PolarConfig(9.0, 15.0, -3.0, False)
"""Gains of Control/move_to_pose in github.com/AtsushiSakai/PythonRobotics, which subtracts k_beta beta: 3 there."""
AICARDI_CONFIG = AicardiConfig(stop=StopTolerance(0.02, 0.05))
AICARDI_ENDLESS_CONFIG = AicardiConfig(stop=StopTolerance(0.0, 0.0))
"""Never at rest: law (13) as the paper simulates it."""


def new_peer_memory() -> PeerMemory:
    """Return the memory at a new goal, every field spelt out: compiled code knows no defaults."""
    return PeerMemory(False, False, False, 0.0)


def peer_step(peer: int, memory: PeerMemory, local: Pose) -> tuple[PeerMemory, Twist]:
    """One step of the peer with this code.

    Args:
        peer: one of the codes but OURS.
        memory: as left by the last step.
        local: estimate of the pose in the goal's frame.

    Returns:
        The next memory and the command [m/s, rad/s].
    """
    if peer in (GRACEFUL_POSE, GRACEFUL, GRACEFUL_SHIPPED):
        return graceful_step(memory, local, _graceful_config(peer))
    if peer == POLAR:
        return polar_step(memory, local, SIEGWART_CONFIG)
    if peer == POLAR_FAST:
        return polar_step(memory, local, PYTHON_ROBOTICS_CONFIG)
    return aicardi_step(memory, local, AICARDI_CONFIG if peer == AICARDI else AICARDI_ENDLESS_CONFIG)


def _graceful_config(peer: int) -> GracefulConfig:
    if peer == GRACEFUL_POSE:
        return GRACEFUL_POSE_CONFIG
    return GRACEFUL_CONFIG if peer == GRACEFUL else GRACEFUL_SHIPPED_CONFIG


def graceful_curvature(r: float, phi: float, delta: float, k_phi: float, k_delta: float) -> float:
    """Curvature [1/m] that brings the heading onto the manifold delta = atan(-k_phi phi), and along it to the target.

    Source: J. J. Park and B. Kuipers, "A smooth control law for graceful motion of differential wheeled mobile robots
    in 2D environment", ICRA 2011, Eq. (13) with omega = curvature v.

    Args:
        r: [m] distance of the target.
        phi: [rad] heading of the target relative to the line of sight.
        delta: [rad] heading of the robot relative to the line of sight.
        k_phi: [-] k_1 there.
        k_delta: [-] k_2 there.
    """
    fast = k_delta * (delta + math.atan(k_phi * phi))
    along = (1.0 + k_phi / (1.0 + (k_phi * phi) ** 2)) * math.sin(delta)
    return -(fast + along) / max(r, _NEAR)


def graceful_velocity(r: float, curvature: float, config: GracefulConfig) -> Twist:
    """Speed for a curvature [1/m] at distance ``r`` [m] of the target.

    Source: Park and Kuipers, ICRA 2011, Eq. (15), v = v_max / (1 + beta |curvature|^lambda); slowing down near the
    target, least speed and the bound of omega that keeps the curvature: Nav2's smooth_control_law.cpp.
    """
    v = config.v_linear_max / (1.0 + config.beta * abs(curvature) ** config.lambda_)
    v = min(v, config.v_linear_max * r / config.slowdown_radius)
    v = min(max(v, config.v_linear_min), config.v_linear_max)
    if abs(curvature) * v > config.v_angular_max:
        v = config.v_angular_max / abs(curvature)
    return Twist(v, curvature * v)


def turn_in_place(angle: float, config: GracefulConfig) -> Twist:
    """Turn by ``angle`` [rad], still to go: in proportion to it, and not slower than ``v_angular_min_in_place``.

    Source: Nav2's graceful_controller.cpp.
    """
    omega = config.rotation_scaling_factor * config.v_angular_max * angle
    return Twist(0.0, math.copysign(max(abs(omega), config.v_angular_min_in_place), omega))


def graceful_step(memory: PeerMemory, local: Pose, config: GracefulConfig) -> tuple[PeerMemory, Twist]:
    """Park and Kuipers' law with Nav2's limits, rotations in place and finish.

    Nav2 drives to a target on a planned path, at most ``max_lookahead`` ahead. There is no planner here: the path is
    the straight line from the robot to the goal, planned anew at each pose, its heading along the line, and with
    ``prefer_final_rotation`` its end has that heading too.
    """
    rho, alpha, beta = navigation_variables(local)
    stop = config.stop
    arrived = memory.arrived or rho < stop.xy_goal_tolerance
    if arrived:
        reached = memory.reached or abs(local.theta) < stop.yaw_goal_tolerance
        after = PeerMemory(True, True, reached, 0.0)
        return after, Twist(0.0, 0.0) if reached else turn_in_place(-local.theta, config)
    turned = memory.turned or not config.initial_rotation or abs(alpha) < config.initial_rotation_tolerance
    after = PeerMemory(turned, False, False, 0.0)
    if not turned:
        return after, turn_in_place(alpha, config)
    r = min(rho, config.max_lookahead)
    straight = config.prefer_final_rotation or rho > config.max_lookahead
    backward = config.allow_backward and not in_front(alpha)
    # Backwards the robot is one that faces the other way, and so does its goal; a path's heading is that of travel.
    half_turn = math.pi if backward else 0.0
    phi = 0.0 if straight else wrap_angle(half_turn - beta)
    delta = wrap_angle(half_turn - alpha)
    forward = graceful_velocity(r, graceful_curvature(r, phi, delta, config.k_phi, config.k_delta), config)
    return after, Twist(-forward.v, forward.omega) if backward else forward


def polar_law(rho: float, alpha: float, beta: float, config: PolarConfig) -> Twist:
    """Drive with v = k_rho rho, omega = k_alpha alpha + k_beta beta, where beta = -theta - alpha.

    Source: A. Astolfi, "Exponential stabilization of a wheeled mobile robot via discontinuous control", ASME Journal
    of Dynamic Systems, Measurement and Control 121 (1999); in the letters of Siegwart and Nourbakhsh, section 3.6.2.
    Locally stable for k_rho > 0, k_beta < 0, k_alpha > k_rho.

    Args:
        rho: [m] distance of the goal.
        alpha: [rad] its bearing in the robot's frame.
        beta: [rad] minus its bearing in the goal's frame.
        config: gains.
    """
    return Twist(config.k_rho * rho, config.k_alpha * alpha + config.k_beta * beta)


def polar_step(memory: PeerMemory, local: Pose, config: PolarConfig) -> tuple[PeerMemory, Twist]:
    """The linear polar law, backwards when the goal is behind: robot and goal then face the other way."""
    rho, alpha, beta = navigation_variables(local)
    reached = memory.reached or _inside(rho, local.theta, config.stop)
    direction = memory.direction
    if direction == 0.0 or not config.keep_direction:
        direction = -1.0 if abs(alpha) > HALF_PI else 1.0
    after = PeerMemory(True, reached, reached, direction)
    if reached:
        return after, Twist(0.0, 0.0)
    if direction > 0.0:
        return after, polar_law(rho, alpha, -beta, config)
    behind = wrap_angle(alpha + math.pi)
    forwards = polar_law(rho, behind, wrap_angle(-local.theta - behind), config)
    return after, Twist(-forwards.v, forwards.omega)


def aicardi_step(memory: PeerMemory, local: Pose, config: AicardiConfig) -> tuple[PeerMemory, Twist]:
    """Law (13) all the way: the law of Aicardi et al. with tanh(rho) in place of rho, which bounds the speed.

    Source: M. Aicardi, G. Casalino, A. Bicchi, A. Balestrino, "Closed loop steering of unicycle-like vehicles via
    Lyapunov techniques", IEEE Robotics and Automation Magazine 2 (1995).
    """
    navigation = navigation_variables(local)
    reached = memory.reached or _inside(navigation.rho, local.theta, config.stop)
    after = PeerMemory(True, reached, reached, 0.0)
    return after, Twist(0.0, 0.0) if reached else global_law(navigation, config.gains)


def _inside(rho: float, theta: float, stop: StopTolerance) -> bool:
    return rho < stop.xy_goal_tolerance and abs(theta) < stop.yaw_goal_tolerance
