"""The command ``diffbot check``: observe a running robot and report what to do."""

from __future__ import annotations

import argparse
import importlib
import json
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError
from diffbot_core.schema import build, parameters_of
from diffbot_core.yaml_files import read_sections, values_for
from diffbot_tools.arguments import duration


def add_check(commands: Any) -> None:
    """Add ``diffbot check`` to the subparsers of the command line."""
    check = commands.add_parser(
        "check",
        help="observe a running robot: print a line for each input and output, what is wrong, and what to do",
        epilog="The nodes ekf and controller may run, but need not. Drive the robot during the check, so that twist, "
        "pose, gyro and commands can be compared. Exit status: 0 nothing to do, 1 something to do.",
    )
    check.add_argument("file", nargs="?", type=Path, help="parameter file of the robot, for nodes that do not run yet")
    check.add_argument("--namespace", default="", metavar="NS", help="namespace of the robot")
    check.add_argument(
        "--duration", type=duration, default=10.0, metavar="S", help="duration of the check [s] (default: %(default)g)"
    )
    check.add_argument("--json", action="store_true", help="print JSON")
    check.add_argument("--ros-args", dest="ros_args", nargs=argparse.REMAINDER, default=[], help="remappings")
    check.set_defaults(call=_check)


def _check(options: argparse.Namespace) -> int:
    values = {} if options.file is None else _values_in(options.file)
    # Imported by name, since the command line must start without ROS.
    observer_type = importlib.import_module("diffbot_tools.check.ros.observer").Observer
    try:
        observer = observer_type(options.namespace, values, options.ros_args)
    except Exception as error:  # rclpy raises several types for invalid names
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


def _values_in(file: Path) -> dict[str, dict[str, Any]]:
    """Return the parameters of ekf and controller, if a file has sections for them.

    Raises:
        DiffbotError: if the file cannot be read, or a value is not allowed.
    """
    from diffbot_control.ros.parameters.controller import ControllerNodeConfig  # noqa: PLC0415
    from diffbot_control.ros.parameters.ekf import EkfNodeConfig  # noqa: PLC0415 - only the called command is loaded
    from diffbot_tools.parameter_file import values_of  # noqa: PLC0415

    nodes = {one.node for one in read_sections(file)}
    values = {name: values_for(file, name) for name in ("ekf", "controller") if nodes & {name, "*", "**"}}
    if "ekf" in values:
        values["ekf"] = values_of(values["ekf"], EkfNodeConfig)
    # The controller may also have parameters of a law of the user.
    names = {one.name for one in parameters_of(ControllerNodeConfig)}
    build(ControllerNodeConfig, {name: one for name, one in values.get("controller", {}).items() if name in names})
    return values
