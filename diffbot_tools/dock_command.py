"""The commands ``diffbot dock`` and ``diffbot undock``: goals in the frame of the dock, to docking_node."""

from __future__ import annotations

import argparse
import math
from typing import Any

from diffbot_control.goals.goal_record import RESTART_TIMEOUT
from diffbot_control.law.docking_axis import pose_on_axis
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE, Pose, out_of_frame
from diffbot_core.ranges import HEADING
from diffbot_tools.arguments import duration, number_between
from diffbot_tools.goal_command import GoalOptions, run

FRAME, CONTROLLER = "dock", "dock_controller"
DISTANCE = 0.7
"""[m] of the staging pose from the docked one, as the law has it by default"""
_STATUS = "exit status: as of diffbot goal"


def add_dock(commands: Any) -> None:
    """Add ``diffbot dock`` to the subparsers of the command line."""
    dock = commands.add_parser("dock", help="dock where a dock is seen, and report how it ended", epilog=_STATUS)
    position = number_between(-MAX_COORDINATE, MAX_COORDINATE)
    dock.add_argument(
        "pose",
        nargs="*",
        metavar="X Y YAW",
        help="pose of the docked robot in the map [m, m, rad]: drive to the staging pose before it first",
    )
    dock.add_argument("--frame", default="map", help="frame of that pose (default: %(default)s)")
    dock.add_argument("--controller", default="controller", metavar="NAME", help="node that drives there")
    _add_common(dock)
    dock.set_defaults(call=lambda options: _dock(options, [position, position, number_between(*HEADING)]))


def add_undock(commands: Any) -> None:
    """Add ``diffbot undock`` to the subparsers of the command line."""
    undock = commands.add_parser("undock", help="drive out of the dock along its axis", epilog=_STATUS)
    _add_common(undock)
    undock.set_defaults(call=lambda options: run(_in_dock(options, pose_on_axis(options.distance, options.backward))))


def _add_common(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--distance",
        type=number_between(0.05, 100.0),
        default=DISTANCE,
        metavar="M",
        help="of the pose on the axis before the dock [m] (default: %(default)g)",
    )
    command.add_argument("--backward", action="store_true", help="the back of the robot docks (dock_backward)")
    command.add_argument("--timeout", type=duration, default=math.inf, metavar="S", help="cancel after this time [s]")
    command.add_argument("--namespace", default="", metavar="NS", help="namespace of the robot")
    command.add_argument(
        "--docking-controller", default=CONTROLLER, metavar="NAME", help="its node (default: %(default)s)"
    )


def _dock(options: argparse.Namespace, kinds: list[Any]) -> int:
    """Drive to the staging pose, if the dock's is given, and dock; return the exit status."""
    if options.pose:
        if len(options.pose) != len(kinds):
            raise InvalidValueError("X Y YAW", " ".join(options.pose), "three numbers, or none")
        try:
            numbers = [kind(text) for kind, text in zip(kinds, options.pose, strict=True)]
        except (ValueError, argparse.ArgumentTypeError) as error:
            raise InvalidValueError("X Y YAW", " ".join(options.pose), str(error)) from None
        staging = out_of_frame(pose_on_axis(options.distance, options.backward), Pose(*numbers))
        names = options.namespace, options.controller
        status = run(GoalOptions(staging, options.frame, True, options.timeout, *names, RESTART_TIMEOUT))
        if status:
            return status
    return run(_in_dock(options, Pose(0.0, 0.0, 0.0)))


def _in_dock(options: argparse.Namespace, pose: Pose) -> GoalOptions:
    names = options.namespace, options.docking_controller
    return GoalOptions(pose, FRAME, True, options.timeout, *names, RESTART_TIMEOUT)
