"""What is missing in the description of a robot, contradicts itself, or makes it slow to answer."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.goal_checker import is_knowable, smallest_tolerance
from diffbot_control.law.loop_check import unstable_gains
from diffbot_core.data_sheet import rim_speed
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Uncertainty
from diffbot_sim.drive import Drive
from diffbot_tools.bringup.data_sheet import REQUIRED
from diffbot_tools.robot.robot import Robot

MISSING, CONTRADICTION, SLOW = "missing", "contradiction", "slow"
GOALS = {
    "2 m ahead": Pose(2.0, 0.0, 0.0),
    "1 m to the side, turned by 90 deg": Pose(0.0, 1.0, 0.5 * math.pi),
    "0.3 m to the side": Pose(0.0, 0.3, 0.0),
}
"""Goals whose time is estimated, in the frame of the robot."""
_RESTING_TIME = 60.0
"""[s] for which the robot is let stand"""
_SLOW_TO_KNOW = 5.0
"""[s]"""
_ALIKE = 1.5
"""ratio up to which two statements of one deviation agree"""


class Finding(NamedTuple):
    """Something that is wrong with a description."""

    kind: str
    """MISSING, CONTRADICTION or SLOW"""
    text: str


class AtRest(NamedTuple):
    """How well a robot knows its pose while it stands, from its first fix on."""

    uncertainty: Uncertainty
    """after a minute"""
    known: float
    """[s] after which a goal could count as reached; inf: never within a minute"""


def findings(robot: Robot, rest: AtRest | None) -> list[Finding]:
    """Return what is wrong with a description; ``rest`` is None for a robot with another law than this project's."""
    slow = [] if rest is None else [Finding(SLOW, text) for text in _slow(robot, rest)]
    missing = [Finding(MISSING, text) for text in _missing(robot)]
    return [*missing, *(Finding(CONTRADICTION, text) for text in _contradictions(robot)), *slow]


def _missing(robot: Robot) -> Iterator[str]:
    controller, ekf, plant = (robot.given[name] for name in ("controller", "ekf", "plant"))
    for name in ("wheel_radius", "wheel_separation", *REQUIRED):
        if name not in controller:
            yield f"{name} of the controller: a robot is not driven without its data sheet"
    if "command_latency" not in controller:
        yield "command_latency of the controller: a wrong one is the usual reason for swinging at the goal"
    for name in ("global_pose_sigma_xy", "global_pose_sigma_yaw"):
        if name not in ekf and robot.plant.world.sensors.fix_rate > 0.0:
            yield f"{name} of the ekf: a global_pose without covariance is dropped"
    if not any(name.startswith(("eps_", "fix_", "landmark_")) for name in plant):
        yield "sensors of the plant: the simulation has those of the paper, which are wrong by up to 0.3 m"


def _contradictions(robot: Robot) -> Iterator[str]:
    sheet, world = robot.controller.supervisor.controller.data_sheet, robot.plant.simulated()
    actuators, wheels = world.plant.actuators, sheet.wheels
    separations = {
        "controller": wheels.wheel_separation,
        "ekf": robot.ekf.wheels.wheel_separation,
        "plant": world.plant.wheels.wheel_separation,
    }
    for name, values in (
        ("wheel_separation [m]", separations),
        (
            "wheel_radius [m]",
            {"controller": wheels.wheel_radius, "plant": world.plant.wheels.wheel_radius},
        ),
        ("dead time [s]", {"controller": sheet.command_latency, "plant": actuators.command_delay}),
        ("drive_time_constant [s]", {"controller": sheet.drive_time_constant, "plant": actuators.drive_time_constant}),
    ):
        if len(set(values.values())) > 1:
            yield f"{name}: " + ", ".join(f"{node} {value:g}" for node, value in values.items())
    if rim_speed(sheet) < 0.999 * sheet.v_max:
        yield f"linear.x.max_velocity = {sheet.v_max:g}: wheel.max_velocity allows {rim_speed(sheet):.3g} m/s only"
    for name, allowed, asked in (
        ("linear.x.max_acceleration", actuators.acceleration_max, sheet.a_max),
        ("angular.z.max_acceleration", actuators.angular_acceleration_max, sheet.omega_dot_max),
    ):
        if allowed < asked:
            yield f"{name} = {asked:g}: the plant does {allowed:g} only"
    sensors, noise = world.sensors, robot.ekf.noise
    for name, simulated, stated in (
        ("global_pose_sigma_xy", sensors.eps_x_max / math.sqrt(3.0), noise.global_pose_sigma_xy),
        ("global_pose_sigma_yaw", sensors.eps_theta_max / math.sqrt(3.0), noise.global_pose_sigma_yaw),
    ):
        if stated and not stated / _ALIKE <= simulated <= stated * _ALIKE:
            yield f"{name} = {stated:g}: the plant's poses have {simulated:.3g}"
    period = world.plant.sampling_time
    if robot.controller.supervisor.pose_timeout < 2.0 * period:
        yield f"pose_timeout = {robot.controller.supervisor.pose_timeout:g} s is less than two periods of odom"
    controller = robot.controller.supervisor.controller
    if isinstance(controller, ControllerConfig) and (warning := unstable_gains(controller, period)):
        yield warning


def at_rest(robot: Robot) -> AtRest:
    """Let the robot stand for a minute with its filter running."""
    simulation, tolerance = robot.simulation(), robot.controller.supervisor.controller.tolerance
    scale = robot.controller.supervisor.controller.uncertainty_scale
    known, uncertainty = math.inf, Uncertainty(math.inf, math.inf)
    while simulation.time < _RESTING_TIME:
        simulation.sense()
        if simulation.estimate is not None:
            xy, theta = simulation.uncertainty
            uncertainty = Uncertainty(scale * xy, scale * theta)
            if not is_knowable(tolerance, uncertainty):
                known = math.inf
            elif known == math.inf:
                known = simulation.time
        simulation.world.advance(Twist(0.0, 0.0))
    return AtRest(uncertainty, known)


def trial_drives(robot: Robot) -> dict[str, Drive]:
    """Return a drive to each of GOALS, from where the robot stands; its own noise for each."""
    drives = {}
    for seed, (name, goal) in enumerate(GOALS.items(), 1):
        simulation = robot.simulation(seed)
        x, y, theta = simulation.world.state.pose
        turned = Pose(
            x + math.cos(theta) * goal.x - math.sin(theta) * goal.y,
            y + math.sin(theta) * goal.x + math.cos(theta) * goal.y,
            theta + goal.theta,
        )
        drives[name] = simulation.drive(turned)
    return drives


def _slow(robot: Robot, rest: AtRest) -> Iterator[str]:
    tolerance = robot.controller.supervisor.controller.tolerance
    if rest.known == math.inf:
        xy, theta = smallest_tolerance(tolerance, rest.uncertainty)
        yield (
            f"the pose never gets certain enough for an answer: better poses, or xy_goal_tolerance >= {1.2 * xy:.2g} m"
            f" and yaw_goal_tolerance >= {1.2 * theta:.2g} rad"
        )
    elif rest.known > _SLOW_TO_KNOW:
        yield f"the pose is certain enough for an answer only {rest.known:.0f} s after the first one: wider tolerances"
