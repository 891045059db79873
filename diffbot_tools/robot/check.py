"""What is missing in the description of a robot, contradicts itself, or makes it slow to answer."""

from __future__ import annotations

import math
from collections.abc import Iterator

from diffbot_control.goals import data_sheet_of
from diffbot_control.law.goal_checker import is_knowable, smallest_tolerance
from diffbot_core.data_sheet import rim_speed
from diffbot_core.geometry import Pose, out_of_frame
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Uncertainty
from diffbot_sim.drive import Drive
from diffbot_tools.bringup.data_sheet import REQUIRED
from diffbot_tools.robot.robot import Robot

GOALS = {
    "2 m ahead": Pose(2.0, 0.0, 0.0),
    "1 m to the side, turned by 90 deg": Pose(0.0, 1.0, 0.5 * math.pi),
    "0.3 m to the side": Pose(0.0, 0.3, 0.0),
}
"""Goals whose time is estimated, in the frame of the robot."""
_RESTING_TIME, _SLOW = 60.0, 5.0
"""[s] for which the robot is let stand; after which a pose that is good enough comes late"""
_ALIKE = 1.5
"""ratio up to which two statements of one deviation agree"""


def missing(robot: Robot) -> Iterator[str]:
    """Yield what the file has to say and does not."""
    for name in ("wheel_radius", "wheel_separation", *REQUIRED):
        if name not in robot.given["controller"]:
            yield f"{name} of the controller: a robot is not driven without its data sheet"
    if "command_latency" not in robot.given["controller"]:
        yield "command_latency of the controller: a wrong one is the usual reason for swinging at the goal"
    for name in ("global_pose_sigma_xy", "global_pose_sigma_yaw"):
        if name not in robot.given["ekf"] and robot.plant.world.sensors.fix_rate > 0.0:
            yield f"{name} of the ekf: a global_pose without covariance is dropped"
    if not any(name.startswith(("eps_", "fix_", "landmark_")) for name in robot.given["plant"]):
        yield "sensors of the plant: the simulation has those of the paper, which are wrong by up to 0.3 m"


def contradictions(robot: Robot) -> Iterator[str]:
    """Yield what cannot be true together."""
    supervisor, world, noise = robot.controller.supervisor, robot.plant.simulated(), robot.ekf.noise
    controller, plant, sensors = supervisor.controller, world.plant, world.sensors
    sheet, drives = data_sheet_of(controller), plant.actuators
    separations = {"plant": plant.wheels.wheel_separation, "ekf": robot.ekf.wheels.wheel_separation}
    equal = {"wheel_separation [m]": separations}
    limits = [("two periods of odom", 2.0 * plant.sampling_time, supervisor.pose_timeout, "pose_timeout is")]
    if sheet is not None:
        equal = {
            "wheel_separation [m]": {"controller": sheet.wheels.wheel_separation, **separations},
            "wheel_radius [m]": {"controller": sheet.wheels.wheel_radius, "plant": plant.wheels.wheel_radius},
            "dead time [s]": {"controller": sheet.command_latency, "plant": drives.command_delay},
            "drive_time_constant [s]": {
                "controller": sheet.drive_time_constant,
                "plant": drives.drive_time_constant,
            },
        }
        limits += [
            ("linear.x.max_velocity", 0.999 * sheet.v_max, rim_speed(sheet), "wheel.max_velocity allows"),
            ("linear.x.max_acceleration", sheet.a_max, drives.acceleration_max, "the plant does"),
            ("angular.z.max_acceleration", sheet.omega_dot_max, drives.angular_acceleration_max, "the plant does"),
        ]
    for name, values in equal.items():
        if len(set(values.values())) > 1:
            yield f"{name}: " + ", ".join(f"{node} {value:g}" for node, value in values.items())
    for name, asked, allowed, who in limits:
        if allowed < asked:
            yield f"{name} = {asked:.3g}: {who} {allowed:.3g} only"
    for name, simulated, stated in (
        ("global_pose_sigma_xy", sensors.eps_x_max / math.sqrt(3.0), noise.global_pose_sigma_xy),
        ("global_pose_sigma_yaw", sensors.eps_theta_max / math.sqrt(3.0), noise.global_pose_sigma_yaw),
    ):
        if stated and not stated / _ALIKE <= simulated <= stated * _ALIKE:
            yield f"{name} = {stated:g}: the plant's poses have {simulated:.3g}"


def at_rest(robot: Robot) -> tuple[Uncertainty, float]:
    """Let the robot stand for a minute: how well it knows its pose then, and after what time [s] well enough.

    That is the time from which on a goal could count as reached; inf if there is none.
    """
    simulation, controller = robot.simulation(), robot.controller.supervisor.controller
    known, uncertainty = math.inf, Uncertainty(math.inf, math.inf)
    while simulation.time < _RESTING_TIME:
        simulation.sense()
        if simulation.estimate is not None:
            uncertainty = Uncertainty(*(controller.uncertainty_scale * sigma for sigma in simulation.uncertainty))
            is_known = is_knowable(controller.tolerance, uncertainty)
            known = min(known, simulation.time) if is_known else math.inf
        simulation.world.advance(Twist(0.0, 0.0))
    return uncertainty, known


def slow(robot: Robot, uncertainty: Uncertainty, known: float) -> Iterator[str]:
    """Yield why answers come late; the arguments are what :func:`at_rest` returns."""
    if known == math.inf:
        xy, theta = smallest_tolerance(robot.controller.supervisor.controller.tolerance, uncertainty)
        wide = f"xy_goal_tolerance >= {1.2 * xy:.2g} m and yaw_goal_tolerance >= {1.2 * theta:.2g} rad"
        yield f"the pose never gets certain enough for an answer: better poses, or {wide}"
    elif known > _SLOW:
        yield f"the pose is certain enough for an answer only {known:.0f} s after the first one: wider tolerances"


def trial_drives(robot: Robot) -> dict[str, Drive]:
    """Return a drive to each of GOALS, each with its own noise."""
    found = {}
    for seed, (name, goal) in enumerate(GOALS.items(), 1):
        simulation = robot.simulation(seed)
        found[name] = simulation.drive(out_of_frame(goal, simulation.truth))
    return found
