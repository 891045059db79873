"""The command ``diffbot check``: looks at a running robot and reports what has to be done."""

from __future__ import annotations

import argparse
import importlib
import json
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError
from diffbot_core.yaml_files import read_sections, values_for
from diffbot_tools.arguments import duration


def add_check(commands: Any) -> None:
    """Add ``diffbot check`` to the subparsers of the command line."""
    check = commands.add_parser(
        "check",
        help="look at a running robot: each input and output in a line, what is wrong, what to do",
        epilog="Works before ekf and controller are started, and beside them. Drive the robot meanwhile: then twist, "
        "pose, gyro and commands are compared. Exit status: 0 nothing to do, 1 something to do.",
    )
    check.add_argument("file", nargs="?", type=Path, help="parameter file of the robot, for nodes that do not run yet")
    check.add_argument("--namespace", default="", metavar="NS", help="namespace of the robot")
    check.add_argument("--duration", type=duration, default=10.0, metavar="S", help="[s] (default: %(default)g)")
    check.add_argument("--json", action="store_true", help="print JSON")
    check.add_argument("--ros-args", dest="ros_args", nargs=argparse.REMAINDER, default=[], help="remappings ...")
    check.set_defaults(call=_call)


def _call(options: argparse.Namespace) -> int:
    values: dict[str, dict[str, Any]] = {}
    if options.file is not None:
        from diffbot_control.ros.parameters.ekf import EkfNodeConfig  # noqa: PLC0415 - only the called command is loaded
        from diffbot_tools.parameter_file import values_of  # noqa: PLC0415

        given = {one.node for one in read_sections(options.file)}
        values = {name: values_for(options.file, name) for name in ("ekf", "controller") if given & {name, "**", "/**"}}
        if "ekf" in values:
            values["ekf"] = values_of(values["ekf"], EkfNodeConfig)
    # By name: the command line can be imported without ROS.
    observer_type = importlib.import_module("diffbot_tools.live.ros.observer").Observer
    try:
        observer = observer_type(options.namespace, values, options.ros_args)
    except Exception as error:  # rclpy raises several types for names that no node can have
        raise DiffbotError(f"namespace {options.namespace!r}: {' '.join(str(error).split())}") from None
    try:
        lines, has_moved = observer.observe(options.duration)
    finally:
        observer.close()
    todo = sum(len(one.todo) for one in lines)
    if options.json:
        print(json.dumps([one._asdict() for one in lines], indent=1))
        return int(todo > 0)
    print("\n".join(one.text() for one in lines))
    if not has_moved:
        print("The robot did not move: drive it during a check to compare twist, pose, gyro and commands.")
    print(f"{todo} thing{'s' * (todo != 1)} to do" if todo else "nothing to do")
    return int(todo > 0)
