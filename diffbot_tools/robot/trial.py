"""Many simulated drives of a robot to random goals, and what came of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from diffbot_core.geometry import Pose, wrap_angle
from diffbot_sim.drive import Drive
from diffbot_tools.robot.picture import draw_drives
from diffbot_tools.robot.robot import Robot

FAR, SHORT = "far", "short"
_FAR_TIME = 2.0, 12.0
"""[s] at full speed to a far goal"""
_SHORT_TOLERANCES = 1.0, 5.0
"""tolerances to a short one"""
_DRAWN = 12
"""drives in the picture"""


class Trial(NamedTuple):
    """One drive of a trial."""

    kind: str
    """FAR or SHORT"""
    drive: Drive


def trials(robot: Robot, goals: int, seed: int) -> Iterator[Trial]:
    """Drive to ``goals`` random goals one after the other, far and short ones in turn; ``seed`` names all noise."""
    generator, simulation = np.random.default_rng(seed), robot.simulation(seed)
    controller = robot.controller.supervisor.controller
    ranges = {
        FAR: [time * min(controller.data_sheet.v_max, 10.0) for time in _FAR_TIME],
        SHORT: [number * controller.tolerance.xy_goal_tolerance for number in _SHORT_TOLERANCES],
    }
    for number in range(goals):
        kind = FAR if number % 2 == 0 else SHORT
        distance, direction, heading = generator.uniform(*ranges[kind]), *generator.uniform(-math.pi, math.pi, 2)
        here = simulation.world.state.pose
        x, y = here.x + distance * math.cos(direction), here.y + distance * math.sin(direction)
        yield Trial(kind, simulation.drive(Pose(float(x), float(y), wrap_angle(float(heading)))))


def summary(robot: Robot, found: list[Trial]) -> str:
    """Lay out for a terminal how many goals were answered, when, and how near the robot truly was."""
    tolerance = robot.controller.supervisor.controller.tolerance
    lines = [f"{'goals':<7}{'reached':>10}{'falsely':>9}{'time [s]: median':>18}{'longest':>9}", ""]
    lines[0] += f"{'error [m]: median':>19}{'largest':>9}{'[deg]: largest':>16}"
    lines[1] = "-" * len(lines[0])
    for kind in (FAR, SHORT):
        drives = [one.drive for one in found if one.kind == kind]
        if not drives:
            continue
        reached = [one for one in drives if one.is_reached]
        false = sum(
            one.position_error > tolerance.xy_goal_tolerance or abs(one.error.theta) > tolerance.yaw_goal_tolerance
            for one in reached
        )
        times, errors = [one.duration for one in drives], [one.position_error for one in drives]
        turns = [math.degrees(abs(one.error.theta)) for one in drives]
        lines.append(
            f"{kind:<7}{f'{len(reached)} of {len(drives)}':>10}{false:>9}{np.median(times):>18.1f}{max(times):>9.1f}"
            f"{np.median(errors):>19.3f}{max(errors):>9.3f}{max(turns):>16.1f}"
        )
    missed = [one.drive for one in found if not one.drive.is_reached]
    lines += [f"{one.end} after {one.duration:.0f} s: {one.reason}" for one in missed[:5]]
    return "\n".join(lines)


def save_picture(found: list[Trial], path: Path) -> None:
    """Draw the first drives of a trial.

    Raises:
        OSError: if the picture cannot be written.
    """
    from diffbot_tools.plotting import new_pair, save  # noqa: PLC0415 - takes a second to load

    figure, left, right = new_pair((11.0, 5.0))
    draw_drives(left, right, [one.drive for one in found[:_DRAWN]])
    left.set_title(f"the first {min(len(found), _DRAWN)} of {len(found)} goals")
    save(figure, path)
