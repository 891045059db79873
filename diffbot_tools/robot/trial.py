"""Simulate many drives of a robot to random goals and summarise the results."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from diffbot_core.data_sheet import DataSheet, leg_times
from diffbot_core.geometry import Pose, into_frame, straight_legs, wrap_angle
from diffbot_sim.drive import Drive
from diffbot_tools.robot.robot import Robot

FAR, SHORT = "far", "short"
_FAR_TIME, _SHORT_TOLERANCES = (2.0, 12.0), (1.0, 5.0)
"""[s] at full speed to a far goal; tolerances to a short one"""
_DRAWN = 12
"""drives in the picture"""


def trials(robot: Robot, goals: int, seed: int) -> Iterator[tuple[str, Drive]]:
    """Drive to ``goals`` random goals one after the other, FAR and SHORT ones in turn; ``seed`` names all noise."""
    generator, simulation = np.random.default_rng(seed), robot.simulation(seed)
    units = {FAR: min(robot.data_sheet.v_max, 10.0), SHORT: robot.tolerance.xy_goal_tolerance}
    for number in range(goals):
        kind, span = (SHORT, _SHORT_TOLERANCES) if number % 2 else (FAR, _FAR_TIME)
        distance, direction = units[kind] * generator.uniform(*span), generator.uniform(-math.pi, math.pi)
        x, y = (distance * turn(direction) for turn in (math.cos, math.sin))
        here, heading = simulation.truth, generator.uniform(-math.pi, math.pi)
        yield kind, simulation.drive(Pose(float(here.x + x), float(here.y + y), wrap_angle(float(heading))))


def summary(robot: Robot, found: list[tuple[str, Drive]]) -> str:
    """Lay out for a terminal how many goals were answered, when, and how near the robot truly was."""
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
    lines.append(f"falsely: reached, but the true pose is not within {within} of the goal")
    lines.append("ideal: turn, drive straight on, turn, each as fast as the data sheet allows (median of the ratios)")
    missed = [one for _, one in found if not one.is_reached]
    return "\n".join([*lines, *(f"{one.end} after {one.duration:.0f} s: {one.reason}" for one in missed[:5])])


def median_share(robot: Robot, drives: list[Drive]) -> float:
    """Return the median of the drives' durations over the least times to turn, drive straight on and turn."""
    return float(np.median([one.duration / _ideal_time(one, robot.data_sheet) for one in drives]))


def _ideal_time(drive: Drive, sheet: DataSheet) -> float:
    start = into_frame(Pose(*drive.truth[0].tolist()), drive.goal)
    return min(sum(leg_times(*straight_legs(start, backwards=one), sheet)) for one in (False, True))


def save_picture(found: list[tuple[str, Drive]], path: Path) -> None:
    """Draw the first drives of a trial.

    Raises:
        OSError: if the picture cannot be written.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 - takes a second to load

    from diffbot_tools.plotting import save  # noqa: PLC0415
    from diffbot_tools.robot.picture import draw_drives  # noqa: PLC0415

    figure = Figure(figsize=(11.0, 5.0), layout="constrained")
    draw_drives(figure, [drive for _, drive in found[:_DRAWN]])
    figure.suptitle(f"the first {min(len(found), _DRAWN)} of {len(found)} goals")
    save(figure, path)
