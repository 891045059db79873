"""A real robot is driven by its own limits: neither the launch file nor ``diffbot run`` starts without them."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from diffbot_control.ros.parameters.controller import ControllerNodeConfig
from diffbot_core.bounded_yaml import load_yaml
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import DiffbotError
from diffbot_core.parameter_files import read_sections, values_for
from diffbot_core.schema import parameters_of, to_dict
from diffbot_sim.ros.parameters import PlantNodeConfig

REQUIRED = (
    "linear.x.max_velocity",
    "angular.z.max_velocity",
    "linear.x.max_acceleration",
    "angular.z.max_acceleration",
)
"""Parameters of the controller whose defaults are the paper's robot's, or no limit at all."""
CONTROLLER, EKF, PLANT = "controller", "ekf", "plant"


def check_data_sheet(file: Path) -> None:
    """Refuse a parameter file whose section of the controller lacks a limit of the robot.

    Raises:
        DiffbotError: naming the file and what it lacks, or if it cannot be read.
    """
    values = values_for(file, CONTROLLER)
    missing = [name for name in REQUIRED if name not in values]
    if missing:
        raise DiffbotError(
            f"{file}: /**/controller lacks {', '.join(missing)}: a robot is not driven without its limits"
        )


def check_limits(nodes: Collection[str], ros_arguments: Sequence[str]) -> None:
    """Refuse a controller that gets a parameter file, but not the limits of its robot.

    Without limits, it would drive the robot with those of the paper's. This is right for a plant in the same process
    that is the same robot, and for a process without parameter files, which is the paper's robot as a whole.

    Args:
        nodes: names of the nodes of the process.
        ros_arguments: of the process, without ``--ros-args``.

    Raises:
        DiffbotError: in one line, if limits are missing, or a file cannot be read.
    """
    files = [value for flag, value in itertools.pairwise(ros_arguments) if flag == "--params-file"]
    if CONTROLLER not in nodes or not files:
        return
    given = _values_given(CONTROLLER, ros_arguments)
    missing = [name for name in REQUIRED if name not in given]
    if not missing:
        return
    reason = "and no plant runs in this process"
    if PLANT in nodes:
        plant = to_dict(PlantNodeConfig()) | _values_given(PLANT, ros_arguments)
        # The ekf has wheels, too; a file may have no section for the controller.
        robot = to_dict(ControllerNodeConfig()) | _values_given(EKF, ros_arguments) | given
        names = [one.name for one in parameters_of(DataSheet) if one.name in plant]
        other = [f"{name} {robot[name]} and {plant[name]}" for name in names if robot[name] != plant[name]]
        if not other:
            return
        reason = f"and the plant is another robot: {', '.join(other)}"
    raise DiffbotError(
        f"{', '.join(files)}: no {', '.join(missing)} for the controller, {reason}. A robot is not driven without its "
        "limits: give them in the section /**, as the file of `diffbot robot new` does"
    )


def _values_given(node: str, words: Sequence[str]) -> dict[str, Any]:
    """Return the parameters of a node from files and from single arguments; as rcl, which lets single ones win."""
    full_name, values = _full_name(node, words), dict[str, Any]()
    for flag, value in itertools.pairwise(words):
        if flag == "--params-file":
            for section in read_sections(Path(value)):
                values |= section.values if section.is_for(full_name) else {}
    name = full_name.rpartition("/")[2]
    for flag, value in itertools.pairwise(words):
        target, _, text = value.partition(":=")
        scope, _, parameter = target.rpartition(":")
        if flag in ("-p", "--param") and scope in ("", name):
            values[parameter] = load_yaml(text, parameter)
    return values


def _full_name(node: str, words: Sequence[str]) -> str:
    """Return the name of a node with its namespace, as it is remapped."""
    namespace, name = "", node
    for flag, value in itertools.pairwise(words):
        target, _, new = value.partition(":=")
        scope, _, what = target.rpartition(":")
        if flag in ("-r", "--remap") and scope in ("", node):
            namespace = new.rstrip("/") if what == "__ns" else namespace
            name = new if what in ("__node", "__name") else name
    return f"{namespace}/{name}"
