"""Simulated drives of a robot, to check its description and to show how it reaches goals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_control.law.goal_checker import is_knowable, smallest_tolerance
from diffbot_core.data_sheet import DataSheet, fastest, rim_speed
from diffbot_core.geometry import Pose, into_frame, out_of_frame, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Uncertainty
from diffbot_sim.simulation import Drive
from diffbot_tools.bringup import REQUIRED
from diffbot_tools.robot import RobotConfig, make_robot

GOALS = {
    "2 m ahead": (2.0, 0.0, 0.0),
    "1 m to the side, turned by 90 deg": (0.0, 1.0, 0.5 * math.pi),
    "0.3 m to the side": (0.0, 0.3, 0.0),
}
"""Goals [m, m, rad] of the trial drives, in the frame of the robot at its start."""
_RESTING_TIME, _SLOW = 60.0, 5.0
"""[s] duration of the simulation at rest, and time after which a pose that is still uncertain is reported as slow"""
_ALIKE = 1.5
"""Largest ratio of two standard deviations that do not contradict each other."""
_FACTORS = tuple(1.2**number for number in range(1, 9))
"""Multiples of the smallest possible tolerance that are tried."""
FAR, SHORT = "far", "short"
_FAR_TIME, _SHORT_TOLERANCES = (2.0, 12.0), (1.0, 5.0)
"""range of distances: for far goals in seconds at full speed, for short goals in multiples of the tolerance"""
_DRAWN = 12
"""largest number of drives in the picture"""


def check(robot: RobotConfig) -> int:
    """Print how the trial drives end, and everything in the description that is missing, contradictory or slow.

    Returns:
        Exit status: 0, or 1 if something is missing or contradictory, or a goal is not reached.
    """
    texts = [f"missing: {text}" for text in missing(robot)]
    texts += [f"contradiction: {text}" for text in contradictions(robot)]
    uncertainty, known = at_rest(robot)
    print(f"pose at rest: {uncertainty.xy:.3f} m and {uncertainty.theta:.3f} rad (one standard deviation)")
    is_missed = False
    for name, drive in trial_drives(robot):
        is_missed = is_missed or not drive.is_reached
        print(f"{name}: {drive.end} after {drive.duration:.1f} s" + (f": {drive.reason}" if drive.reason else ""))
    if is_missed:
        texts.append(f"not reached: {wider_tolerances(robot, uncertainty)}")
    elif known > _SLOW and isinstance(robot.controller.supervisor.controller, SwitchingConfig):
        print(f"slow: the pose is certain enough to reach a goal only after {known:.0f} s: set wider tolerances")
    print(*texts, sep="\n", end="\n" * bool(texts))
    return int(bool(texts))


def missing(robot: RobotConfig) -> Iterator[str]:
    """Yield parameters that the file must set but does not, each with the reason."""
    for name in ("wheel_radius", "wheel_separation", *REQUIRED):
        if name not in robot.given["controller"]:
            yield f"{name} of the controller: the law needs the data sheet of the robot"
    if "command_latency" not in robot.given["controller"]:
        yield "command_latency of the controller: a wrong latency is the usual reason for oscillation at the goal"
    for name in ("global_pose_sigma_xy", "global_pose_sigma_yaw"):
        if name not in robot.given["ekf"] and robot.plant.world.sensors.fix_rate > 0.0:
            yield f"{name} of the ekf: a global_pose without covariance is dropped"
    if not any(name.startswith(("eps_", "fix_", "landmark_")) for name in robot.given["plant"]):
        yield "sensors of the plant: the defaults are the paper's sensors, whose poses are wrong by up to 0.3 m"


def contradictions(robot: RobotConfig) -> Iterator[str]:
    """Yield values of the description that contradict each other."""
    supervisor, world, noise = robot.controller.supervisor, robot.plant.world, robot.ekf.noise
    sheet, plant, sensors = robot.data_sheet, world.plant, world.sensors
    equal = {
        "wheel_separation [m]": {
            "controller": sheet.wheels.wheel_separation,
            "plant": plant.wheels.wheel_separation,
            "ekf": robot.ekf.wheels.wheel_separation,
        },
        "wheel_radius [m]": {"controller": sheet.wheels.wheel_radius, "plant": plant.wheels.wheel_radius},
        "command_latency [s]": {"controller": sheet.command_latency, "plant": plant.command_delay},
        "drive_time_constant [s]": {"controller": sheet.drive_time_constant, "plant": plant.drive_time_constant},
    }
    limits = [
        ("two periods of odom", 2.0 * plant.sampling_time, supervisor.pose_timeout, "pose_timeout is"),
        ("linear.x.max_velocity", sheet.v_max, rim_speed(sheet), "wheel.max_velocity allows"),
        ("linear.x.max_acceleration", sheet.a_max, plant.acceleration_max, "the plant allows"),
        ("angular.z.max_acceleration", sheet.omega_dot_max, plant.angular_acceleration_max, "the plant allows"),
    ]
    for name, values in equal.items():
        if len(set(values.values())) > 1:
            yield f"{name}: " + ", ".join(f"{node} {value:g}" for node, value in values.items())
    for name, required, allowed, source in limits:
        if allowed < 0.999 * required:  # wheel.max_velocity is rounded
            yield f"{name} = {required:.3g}: {source} only {allowed:.3g}"
    for name, simulated, stated in (
        ("global_pose_sigma_xy", sensors.eps_xy_max / math.sqrt(3.0), noise.global_pose_sigma_xy),
        ("global_pose_sigma_yaw", sensors.eps_theta_max / math.sqrt(3.0), noise.global_pose_sigma_yaw),
    ):
        if stated and not stated / _ALIKE <= simulated <= stated * _ALIKE:
            yield f"{name} = {stated:g}: the poses of the plant have {simulated:.3g}"


def at_rest(robot: RobotConfig) -> tuple[Uncertainty, float]:
    """Simulate the robot at rest for a minute.

    Returns:
        The uncertainty of the pose at the end, and the time [s] after which the pose is certain enough for a goal to
        count as reached; inf if it never is.
    """
    simulation, scale = robot.simulation(), robot.controller.supervisor.uncertainty_scale
    known, uncertainty = math.inf, Uncertainty(math.inf, math.inf)
    while simulation.time < _RESTING_TIME:
        simulation.sense()
        if simulation.estimate is not None:
            uncertainty = Uncertainty(*(scale * sigma for sigma in simulation.uncertainty))
            is_known = is_knowable(robot.tolerance, uncertainty)
            known = min(known, simulation.time) if is_known else math.inf
        simulation.world.advance(Twist(0.0, 0.0))
    return uncertainty, known


def trial_drives(robot: RobotConfig) -> Iterator[tuple[str, Drive]]:
    """Yield the name of each of GOALS and a drive to it; each drive has its own noise."""
    for seed, (name, goal) in enumerate(GOALS.items(), 1):
        simulation = robot.simulation(seed)
        yield name, simulation.drive(out_of_frame(Pose(*goal), simulation.truth))


def wider_tolerances(robot: RobotConfig, uncertainty: Uncertainty) -> str:
    """Return a text with the smallest tried tolerances at which every trial drive reaches its goal."""
    if math.inf in uncertainty:
        return "the filter has no pose, since the plant sends no fixes: set fix_rate"
    given = robot.tolerance.xy_goal_tolerance, robot.tolerance.yaw_goal_tolerance
    names = "xy_goal_tolerance", "yaw_goal_tolerance"
    smallest = smallest_tolerance(robot.tolerance, uncertainty)
    for factor in _FACTORS:
        wider = {name: max(old, _up(factor * new)) for name, old, new in zip(names, given, smallest, strict=True)}
        changed = make_robot(robot.name, robot.given | {"controller": robot.given["controller"] | wider})
        if all(drive.is_reached for _, drive in trial_drives(changed)):
            lines = [f"{name}: {wider[name]:g}" for name, old in zip(names, given, strict=True) if wider[name] > old]
            return f"set {' and '.join(lines)}"
    return "wider tolerances would not help"


def _up(value: float) -> float:
    """Return the value rounded up to two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return round(math.ceil(value / unit) * unit, 9)


def trials(robot: RobotConfig, goals: int, seed: int) -> Iterator[tuple[str, Drive]]:
    """Yield kind and drive for each of ``goals`` random goals, FAR and SHORT in turn; ``seed`` sets goals and noise."""
    generator, simulation = np.random.default_rng(seed), robot.simulation(seed)
    units = {FAR: min(robot.data_sheet.v_max, 10.0), SHORT: robot.tolerance.xy_goal_tolerance}
    for number in range(goals):
        kind, span = (SHORT, _SHORT_TOLERANCES) if number % 2 else (FAR, _FAR_TIME)
        distance, direction = units[kind] * generator.uniform(*span), generator.uniform(-math.pi, math.pi)
        x, y = (distance * turn(direction) for turn in (math.cos, math.sin))
        here, heading = simulation.truth, generator.uniform(-math.pi, math.pi)
        yield kind, simulation.drive(Pose(float(here.x + x), float(here.y + y), wrap_angle(float(heading))))


def summary(robot: RobotConfig, found: list[tuple[str, Drive]]) -> str:
    """Return a table of the reached goals, the durations and the true errors."""
    tolerance = robot.tolerance
    head = f"{'goals':<7}{'reached':>10}{'falsely':>9}{'time [s]: median':>18}{'longest':>9}"
    head += f"{'of the ideal':>14}{'error [m]: median':>19}{'largest':>9}{'[deg]: largest':>16}"
    lines = [head, "-" * len(head)]
    for kind in (FAR, SHORT)[: len(found)]:
        drives = [drive for other, drive in found if other == kind]
        times, xy, theta = zip(
            *((one.duration, one.position_error, abs(one.error.theta)) for one in drives), strict=True
        )
        outside = (np.array(xy) > tolerance.xy_goal_tolerance) | (np.array(theta) > tolerance.yaw_goal_tolerance)
        reached = np.array([one.is_reached for one in drives])
        lines.append(
            f"{kind:<7}{f'{reached.sum()} of {len(drives)}':>10}{(reached & outside).sum():>9}"
            f"{np.median(times):>18.1f}{max(times):>9.1f}{median_share(robot, drives):>14.2f}"
            f"{np.median(xy):>19.3f}{max(xy):>9.3f}{math.degrees(max(theta)):>16.1f}"
        )
    within = f"{tolerance.xy_goal_tolerance:g} m and {tolerance.yaw_goal_tolerance:g} rad"
    lines.append(f"falsely: reported as reached, but the true pose is not within {within} of the goal")
    lines.append(
        "of the ideal: median ratio to the time to turn, drive straight and turn, as fast as the data sheet allows"
    )
    missed = [one for _, one in found if not one.is_reached]
    return "\n".join([*lines, *(f"{one.end} after {one.duration:.0f} s: {one.reason}" for one in missed[:5])])


def median_share(robot: RobotConfig, drives: list[Drive]) -> float:
    """Return the median ratio of the duration of a drive to the shortest time to turn, drive straight and turn."""
    return float(np.median([one.duration / _ideal_time(one, robot.data_sheet) for one in drives]))


def _ideal_time(drive: Drive, sheet: DataSheet) -> float:
    """Return the shortest time [s] to turn, drive straight, forwards or backwards, and turn again."""
    x, y, theta = into_frame(Pose(*drive.truth[0].tolist()), drive.goal)
    distance, (speed, rate) = math.hypot(x, y), fastest(sheet)
    times = []
    for heading in (math.atan2(-y, -x), math.atan2(y, x)):
        first = wrap_angle(heading - theta) if distance > 0.0 else 0.0
        turns = (_shortest_time(abs(turn), rate, sheet.omega_dot_max) for turn in (first, wrap_angle(-theta - first)))
        times.append(sum(turns) + _shortest_time(distance, speed, sheet.a_max))
    return min(times)


def _shortest_time(distance: float, speed: float, acceleration: float) -> float:
    """Return the shortest time [s] from rest to rest over a distance [m] or angle [rad] within these limits."""
    if acceleration == math.inf:
        return distance / speed
    if distance * acceleration >= speed * speed:
        return distance / speed + speed / acceleration
    return 2.0 * math.sqrt(distance / acceleration)


def save_picture(found: list[tuple[str, Drive]], path: Path) -> None:
    """Draw the first drives.

    Raises:
        OSError: if the picture cannot be written.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 - takes a second to load

    from diffbot_tools.plotting import save  # noqa: PLC0415

    figure = Figure(figsize=(11.0, 5.0), layout="constrained")
    draw_drives(figure, [drive for _, drive in found[:_DRAWN]])
    figure.suptitle(f"the first {min(len(found), _DRAWN)} of {len(found)} goals")
    save(figure, path)


def draw_drives(figure: Any, drives: Sequence[Drive]) -> None:
    """Draw true and estimated paths with their goals, and the true distance to the goal over time."""
    from diffbot_tools.plotting import BLUE, GREEN, RED, draw_heading  # noqa: PLC0415 - takes a second to load

    path_axes, error_axes = figure.subplots(1, 2)
    span = max(np.ptp(np.vstack([one.truth[:, :2] for one in drives]), axis=0).max(), 0.3)
    for number, drive in enumerate(drives):
        shown = number == 0
        path_axes.plot(*drive.truth[:, :2].T, color=BLUE, linewidth=2.0, label="truth" if shown else None)
        path_axes.plot(*drive.estimate[:, :2].T, color=RED, linewidth=0.7, label="estimate" if shown else None)
        x, y, _ = drive.goal
        path_axes.plot([x], [y], "o", color=GREEN if drive.is_reached else RED, label="goal" if shown else None)
        draw_heading(path_axes, drive.goal, 0.05 * span, GREEN)
        distance = np.hypot(drive.truth[:, 0] - x, drive.truth[:, 1] - y)
        error_axes.plot(drive.time - drive.time[0], distance, color=BLUE, linewidth=1.0, alpha=0.7)
    path_axes.set(xlabel="x [m]", ylabel="y [m]")
    path_axes.set_aspect("equal", adjustable="datalim")
    path_axes.legend(fontsize="small")
    error_axes.set(xlabel="time since the goal was sent [s]", ylabel="true distance from the goal [m]")
    error_axes.set_yscale("log")
    for axes in (path_axes, error_axes):
        axes.grid(alpha=0.3)
