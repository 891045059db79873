"""Time of single steps without ROS, in this process: controller, supervisor, filter, closed loop.

Each function times one round over the same precomputed inputs and returns microseconds of CPU time per step: they wait
for nothing, and the wall clock would count what other programs take from them.
"""

from __future__ import annotations

import time
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from bench_table import Pair
from filterpy.kalman import ExtendedKalmanFilter

from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import OdometryStep, PoseFix
from diffbot_control.filter.options import EKF, FNN, FilterConfig
from diffbot_control.law.controller import ControllerMemory, step
from diffbot_control.law.presets import PAPER, PRESETS
from diffbot_control.law.supervisor import Supervisor, SupervisorConfig
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import Estimate
from diffbot_sim.model.simulator import World, WorldConfig
from diffbot_sim.reference_loop import simulate

_STEPS = 300
"""30 s of simulation A: global and local region, driving and standing."""
_GOAL = Pose(0.0, 0.0, 0.0)
_JACOBIAN = np.array([[1.0, 0.0, -0.03], [0.0, 1.0, 0.04], [0.0, 0.0, 1.0]])
"""Of the motion by 5 cm in some direction."""


class Inputs(NamedTuple):
    """What the functions under test are fed with."""

    poses: list[Pose]
    fixes: list[PoseFix]
    odometry: list[OdometryStep]


@lru_cache(maxsize=1)
def inputs() -> Inputs:
    """Drive the closed loop once and keep its poses, fixes and odometry."""
    recording = simulate(WorldConfig(), PRESETS[PAPER], _GOAL, _STEPS)
    poses = [Pose(*row) for row in recording.feedback.tolist()]
    world, memory, config = World(WorldConfig()), ControllerMemory(), PRESETS[PAPER]
    fixes, odometry = [], []
    for pose in poses:
        fixes += world.sense().fixes
        odometry.append(world.odometry())
        memory, command, _ = step(memory, Estimate(pose), _GOAL, 0.1, config)
        world.advance(command)
    return Inputs(poses, fixes, odometry)


def _per_step(began: int, steps: int) -> float:
    return (time.thread_time_ns() - began) * 1e-3 / steps


def controller_step() -> float:
    """Time :func:`diffbot_control.law.controller.step` along the path."""
    poses, memory, config = inputs().poses, ControllerMemory(), PRESETS[PAPER]
    began = time.thread_time_ns()
    for pose in poses:
        memory, _, _ = step(memory, Estimate(pose), _GOAL, 0.1, config)
    return _per_step(began, len(poses))


def supervisor_on_pose() -> float:
    """Time the same steps through the supervisor, as the node calls it."""
    poses, supervisor = inputs().poses, Supervisor(SupervisorConfig(PRESETS[PAPER]))
    supervisor.on_goal(_GOAL)
    began = time.thread_time_ns()
    for number, pose in enumerate(poses):
        supervisor.on_pose(number * 100_000_000, 0.1 * number, pose)
    return _per_step(began, len(poses))


def localization_step(variant: str) -> float:
    """Time one fix and one odometry a step through the fusion, with its order of stamps, its history and its gate."""
    _, fixes, odometry = inputs()
    localization = Localization(LocalizationConfig(filter=FilterConfig(filter=variant)))
    began = time.thread_time_ns()
    for fix, twist in zip(fixes, odometry, strict=True):
        localization.on_measurement(fix)
        localization.on_odometry(twist)
    return _per_step(began, len(odometry))


def filterpy_step() -> float:
    """Time filterpy's own predict and update for a state of three: constant F and Q, H the identity.

    F is the Jacobian at one heading, so that the covariance is as full as ours: scipy inverts a diagonal one faster.
    """
    fixes = inputs().fixes
    reference = ExtendedKalmanFilter(dim_x=3, dim_z=3)
    reference.x = np.zeros(3)
    reference.F, reference.Q, reference.R = _JACOBIAN, 1e-4 * np.eye(3), fixes[0].R
    H, measured = np.eye(3), [np.array(fix.pose) for fix in fixes]
    began = time.thread_time_ns()
    for z in measured:
        reference.predict()
        reference.update(z, lambda _: H, lambda x: x)
    return _per_step(began, len(fixes))


def closed_loop_step() -> float:
    """Time the ROS-free closed loop: plant, sensors, filter, controller."""
    began = time.thread_time_ns()
    simulate(WorldConfig(), PRESETS[PAPER], _GOAL, _STEPS)
    return _per_step(began, _STEPS + 1)


def against_filterpy(number: int, variant: str) -> Pair:
    """Time filter and reference right after each other, the order changing from round to round."""
    if number % 2 == 0:
        ours = localization_step(variant)
        return Pair(ours, filterpy_step())
    reference = filterpy_step()
    return Pair(localization_step(variant), reference)


def steps_round(number: int) -> dict[str, Pair]:
    """Time each once."""
    return {
        "controller_step": Pair(controller_step(), None),
        "supervisor_on_pose": Pair(supervisor_on_pose(), None),
        "ekf_step": against_filterpy(number, EKF),
        "default_filter_step": against_filterpy(number, FilterConfig().filter),
        "fnn_step": against_filterpy(number, FNN),
        "closed_loop_step": Pair(closed_loop_step(), None),
    }
