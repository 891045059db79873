"""The task of ``DiffbotGoal-v0`` as pure functions: what an action asks, what is observed, and what it earns."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance, within
from diffbot_control.law.limits import limit_velocity
from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist

HEADING_WEIGHT = 0.2
"""[m/rad] of the heading error in the distance that the reward counts"""
TIME_COST, END_REWARD = 0.1, 10.0
"""[1/s] for each second; at the goal, and less for leaving the arena"""


class Task(NamedTuple):
    """What reward and end of an episode depend on."""

    data_sheet: DataSheet
    tolerance: GoalTolerance
    arena: float
    """[m] from the goal: an episode ends beyond it"""
    sampling_time: float
    """[s]"""


class Score(NamedTuple):
    """What a step has earned."""

    reward: float
    reached: bool
    """at rest at the goal"""
    left: bool
    """outside of the arena"""


def requested(v: float, omega: float, data_sheet: DataSheet) -> Twist:
    """Return the command of an action: shares of v_max and omega_max, each within -1 .. 1, inside all bounds."""
    return limit_velocity(Twist(v * data_sheet.v_max, omega * data_sheet.omega_max), data_sheet)


def observed(pose: Pose, twist: Twist) -> tuple[float, float, float, float, float, float, float]:
    """Return the observation, not clipped: of the pose in the goal's frame and of the encoders' twist."""
    rho, alpha, beta = navigation_variables(pose)
    return rho, math.cos(alpha), math.sin(alpha), math.cos(beta), math.sin(beta), twist.v, twist.omega


def score(before: Pose, after: Pose, command: Twist, task: Task) -> Score:
    """Judge a step by the true poses before and after it, in the goal's frame."""
    rho = math.hypot(after.x, after.y)
    reached = within(after, rho, command, task.tolerance, task.data_sheet)
    left = rho > task.arena
    reward = distance(before) - distance(after) - TIME_COST * task.sampling_time
    if reached:
        reward += END_REWARD
    if left:
        reward -= END_REWARD
    return Score(reward, reached, left)


def distance(pose: Pose) -> float:
    """Return what the reward counts [m] for a pose in the goal's frame."""
    return math.hypot(pose.x, pose.y) + HEADING_WEIGHT * abs(pose.theta)
