"""Nav2's graceful controller, unchanged: turns on the spot, lookahead, speeds and defaults of release Jazzy."""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.law import Observation, Report
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, into_frame, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec
from diffbot_lab.laws.common import STOP, LawMemory, PeerLaw, Stop, conclude, new_law_memory, situation_of
from diffbot_lab.laws.graceful import graceful_curvature, graceful_slowdown

_REPLANNING = 1.0
"""[s] time between two plans in Nav2's behaviour trees; each plan starts at the current pose"""
_ALL = 10**9
"""more poses than any path has"""


class Nav2GracefulConfig(NamedTuple):
    """Parameters and defaults of nav2_graceful_controller, Jazzy; ``stop`` is the tolerance of its goal checker.

    Some parameters of Nav2 are left out. ``allow_backward`` must be false if ``initial_rotation`` is true.
    ``min_lookahead`` has no effect, because the path always has a pose within the lookahead. There is no collision
    check. The defaults of Nav2's goal checker are 0.25 m and 0.25 rad.
    """

    max_lookahead: Annotated[float, Spec("largest distance of the target along the path", "m", 0.05, 100.0)] = 1.0
    k_phi: Annotated[float, Spec("k_1 of Park and Kuipers", "-", 0.0, 20.0)] = 2.0
    k_delta: Annotated[float, Spec("k_2 of Park and Kuipers", "-", 0.0, 20.0)] = 1.0
    beta: Annotated[float, Spec("weight of the curvature in the speed", "m^lambda", 0.0, 10.0)] = 0.4
    lambda_: Annotated[float, Spec("exponent of the curvature in the speed", "-", 0.5, 5.0, parameter="lambda")] = 2.0
    v_linear_min: Annotated[float, Spec("smallest speed", "m/s", 0.0, 1.0)] = 0.1
    v_linear_max: Annotated[float, Spec("largest speed", "m/s", 0.01, 10.0)] = 0.5
    v_angular_max: Annotated[float, Spec("largest turn rate", "rad/s", 0.01, 20.0)] = 1.0
    v_angular_min_in_place: Annotated[float, Spec("smallest rate of turns on the spot", "rad/s", 0.0, 5.0)] = 0.25
    slowdown_radius: Annotated[float, Spec("distance below which the speed is proportional to it", "m", 0.05, 10.0)] = (
        1.5
    )
    initial_rotation_tolerance: Annotated[
        float, Spec("bearing below which the initial rotation ends", "rad", 0.01, 3.2)
    ] = 0.75
    rotation_scaling_factor: Annotated[
        float, Spec("turn rate on the spot per radian, as a share of v_angular_max", "1/rad", 0.01, 10.0)
    ] = 0.5
    prefer_final_rotation: Annotated[bool, Spec("drive straight to the goal and turn to its heading at the end")] = True
    path_resolution: Annotated[
        float, Spec("largest distance between two poses of the planner's path", "m", 0.001, 1.0)
    ] = 0.05
    stop: Stop = Stop(0.06, 0.05)
    tolerance: GoalTolerance = GoalTolerance()
    data_sheet: DataSheet = DataSheet()


class FollowedPlan(NamedTuple):
    """A straight line to the goal, and the states of the controller and of the goal checker."""

    x: float
    """[m] start of the line in the goal's frame"""
    y: float
    age: float
    """[s] age of the plan"""
    left: int
    """index of the path's pose that is nearest to the robot, counted from the goal. Poses behind it are discarded"""
    rotates: bool
    """True until the initial rotation ends"""
    checked: bool
    """True if the position has been within the tolerance of the goal checker"""
    done: bool
    """True if the goal checker considers the goal reached"""


def new_plan(x: float, y: float, age: float) -> FollowedPlan:
    """Return a new plan that begins at (x, y) [m]."""
    return FollowedPlan(x, y, age, _ALL, True, False, False)


def rotation_rate(angle: float, config: Nav2GracefulConfig) -> float:
    """Return the rate [rad/s] of a turn on the spot by the remaining ``angle`` [rad], as in ``rotateToTarget``."""
    rate = config.rotation_scaling_factor * abs(angle) * config.v_angular_max
    return math.copysign(max(rate, config.v_angular_min_in_place), angle)


def smooth_velocity(x: float, y: float, heading: float, config: Any) -> Twist:
    """Return the velocity towards a target in the robot's frame, as in ``calculateRegularVelocity``.

    Args:
        x: [m] position of the target.
        y: [m] position of the target.
        heading: [rad] heading of the target.
        config: gains and limits, with the field names of :class:`Nav2GracefulConfig`.
    """
    r, sight = math.hypot(x, y), math.atan2(y, x)
    curvature = graceful_curvature(r, wrap_angle(heading - sight), -sight, config.k_phi, config.k_delta)
    v_max = config.v_linear_max
    v = graceful_slowdown(r, curvature, v_max, config.beta, config.lambda_, config.slowdown_radius)
    v = min(max(v, config.v_linear_min), v_max)
    omega = min(max(curvature * v, -config.v_angular_max), config.v_angular_max)
    return Twist(omega / curvature if curvature != 0.0 else v, omega)


def nav2_graceful(plan: FollowedPlan, pose: Pose, config: Nav2GracefulConfig) -> tuple[FollowedPlan, Twist]:
    """Return plan and command at a pose in the goal's frame, as in ``computeVelocityCommands`` without obstacles.

    The poses of the path are counted from the goal. The target is the pose that is nearest to the goal and within the
    lookahead. Source: github.com/ros-navigation/navigation2, branch jazzy, nav2_graceful_controller.
    """
    length = math.hypot(plan.x, plan.y)
    step = length / math.ceil(length / config.path_resolution) if length > 0.0 else config.path_resolution
    back_x, back_y = (plan.x / length, plan.y / length) if length > 0.0 else (-1.0, 0.0)
    along = min(max(pose.x * back_x + pose.y * back_y, 0.0), length)
    nearest = min(round(along / step), plan.left)
    to_goal = nearest * step
    if to_goal < config.stop.stop_distance:
        # The controller turns until the next plan, because the poses behind the robot are discarded.
        arrived = FollowedPlan(plan.x, plan.y, plan.age, nearest, plan.rotates, plan.checked, plan.done)
        return arrived, Twist(0.0, rotation_rate(-pose.theta, config))
    to_path = math.hypot(pose.x - to_goal * back_x, pose.y - to_goal * back_y)
    target = min(max(math.ceil((to_goal + to_path - config.max_lookahead) / step), 0), nearest)
    on_path = Pose(target * step * back_x, target * step * back_y, math.atan2(-back_y, -back_x) if target > 0 else 0.0)
    x, y, heading = into_frame(on_path, pose)
    sight = math.atan2(y, x)
    if config.prefer_final_rotation and to_goal < config.max_lookahead:
        heading = sight
    if plan.rotates and abs(sight) >= config.initial_rotation_tolerance:
        turning = FollowedPlan(plan.x, plan.y, plan.age, nearest, True, plan.checked, plan.done)
        return turning, Twist(0.0, rotation_rate(sight, config))
    driving = FollowedPlan(plan.x, plan.y, plan.age, nearest, False, plan.checked, plan.done)
    return driving, smooth_velocity(x, y, heading, config)


def check_goal(plan: FollowedPlan, pose: Pose, stop: Stop) -> FollowedPlan:
    """Return the plan after a check by Nav2's SimpleGoalChecker: first the position, once, and then the heading."""
    checked = plan.checked or math.hypot(pose.x, pose.y) <= stop.stop_distance
    done = checked and abs(pose.theta) <= stop.stop_angle
    return FollowedPlan(plan.x, plan.y, plan.age, plan.left, plan.rotates, checked, done)


class Nav2Graceful(PeerLaw):
    """Nav2's graceful controller on a straight path that is planned again every second."""

    name = "nav2_graceful"
    Config = Nav2GracefulConfig

    @staticmethod
    def new_memory(config: Any) -> LawMemory:
        """Return the memory of a robot at rest with a new goal and no plan."""
        return new_law_memory(new_plan(0.0, 0.0, math.inf))

    @staticmethod
    def step(
        memory: LawMemory, observation: Observation, goal: Pose, config: Nav2GracefulConfig
    ) -> tuple[LawMemory, Twist, Report]:
        """Answer one pose, within the limits of the data sheet. Nav2's controller does not predict over latencies."""
        pose, plan = into_frame(observation.estimate.pose, goal), memory.state
        command = STOP
        if not plan.done:
            age = plan.age + observation.dt
            # The margin allows for the rounding error of a sum of periods.
            if age >= _REPLANNING - 1e-6:
                plan = new_plan(pose.x, pose.y, 0.0)
            else:
                plan = FollowedPlan(plan.x, plan.y, age, plan.left, plan.rotates, plan.checked, plan.done)
            plan, command = nav2_graceful(plan, pose, config)
            plan = check_goal(plan, pose, config.stop)
            command = STOP if plan.done else command
        now = situation_of(memory, observation, goal, config.data_sheet)
        return conclude(plan, command, now, config.tolerance, config.data_sheet)
