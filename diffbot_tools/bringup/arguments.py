"""Arguments of the launch files. Those that set a parameter of a node take its bound from the node's configuration."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from diffbot_control.ros.parameters.controller import ControllerNodeConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import Parameter, Spec, checked, parameters_of
from diffbot_sim.ros.parameters import PlantNodeConfig

DISCOVERY_RANGES = ("localhost", "subnet", "off", "system_default")
"""Values of ROS_AUTOMATIC_DISCOVERY_RANGE, in small letters."""
LOG_LEVELS = ("debug", "info", "warn", "error", "fatal")
_BOOLEANS = {"true": True, "True": True, "false": False, "False": False}
_NAMESPACE = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*")
_FRAME_PREFIX = re.compile(r"\w[\w/.-]*")


class Argument(NamedTuple):
    """One argument of a launch file; its value is a text on the command line."""

    parameter: Parameter
    """Name, type, meaning and bound."""
    default: str = ""
    """Empty: not given, so that parameter file and node decide."""

    @property
    def name(self) -> str:
        """Name on the command line."""
        return self.parameter.name

    def choices(self) -> tuple[str, ...]:
        """Return the texts allowed; empty if they are not a list."""
        words = tuple(_BOOLEANS) if self.parameter.type is bool else self.parameter.spec.choices
        return ("", *words) if words and not self.default else words

    def description(self) -> str:
        """Return meaning, unit and bound of a number in one line, for ``ros2 launch --show-args``."""
        spec, kind = self.parameter.spec, self.parameter.type
        unit = f" [{spec.unit}]" if spec.unit != "-" else ""
        return f"{spec.text}{unit}; {spec.bound()}" if kind in (float, int) else f"{spec.text}{unit}"


def _option(name: str, text: str, default: str = "", kind: Any = str, choices: tuple[str, ...] = ()) -> Argument:
    return Argument(Parameter(name, (name,), kind, None, Spec(text, choices=choices)), default)


def _of_node(config_type: type[Any], target: str, name: str = "", default: str = "") -> Argument:
    """Return an argument with the meaning and bound of a node's parameter ``target``, under its name or another."""
    (found,) = (one for one in parameters_of(config_type) if one.name == target)
    return Argument(found._replace(name=name or target), default)


def _common(description: str, discovery_default: str = "") -> tuple[Argument, ...]:
    return (
        _option("namespace", "namespace of the robot; a second one makes a second robot"),
        _option("frame_prefix", "put before the robot's own frames, e.g. robot1/; /tf is then shared by all robots"),
        _option("parameters", "parameter file of all nodes; empty: config/diffbot.yaml of this package"),
        _of_node(ControllerNodeConfig, "preset"),
        _option("localization", "start the ekf; false if another localization publishes the pose", "true", bool),
        _option("composed", "ekf and controller in one process, robot_node", "false", bool),
        _option(
            "autostart", "whether ekf and controller activate themselves; false: a lifecycle manager does", kind=bool
        ),
        _option("docking", "start docking_node, too", "false", bool),
        _option("stamped_cmd_vel", "cmd_vel as TwistStamped instead of Twist", kind=bool),
        _option("bag", "record everything into this folder, which must not exist"),
        _option(
            "discovery_range",
            "hosts that the nodes are visible to, ROS_AUTOMATIC_DISCOVERY_RANGE; empty: as in the environment"
            + discovery_default,
            choices=DISCOVERY_RANGES,
        ),
        _option("log_level", "smallest level that is logged", "info", choices=LOG_LEVELS),
        _option("rviz", "start RViz", "false", bool),
        _option("description", "start robot_state_publisher, if it is installed", description, bool),
        _option("urdf", "description of the robot; empty: urdf/diffbot.urdf of this package"),
    )


ROBOT = (
    *_common(description="false"),
    _option("use_sim_time", "time from /clock: with a replayed bag or another simulator", "false", bool),
)
"""Of robot.launch.py."""
SIMULATION = (
    *_common(description="true", discovery_default=", or localhost if it is not set there"),
    _of_node(PlantNodeConfig, "initial_pose.x", "x"),
    _of_node(PlantNodeConfig, "initial_pose.y", "y"),
    _of_node(PlantNodeConfig, "initial_pose.yaw", "yaw"),
    _of_node(PlantNodeConfig, "seed"),
    _of_node(PlantNodeConfig, "clock", default="wall"),
    _of_node(PlantNodeConfig, "real_time_factor"),
    _option("publish_clock", "whether this plant sends /clock; of several plants only one may", kind=bool),
)
"""Of simulation.launch.py."""


def parse(arguments: tuple[Argument, ...], texts: Mapping[str, str]) -> dict[str, Any]:
    """Return the value of each argument that is given or has a default, by name.

    Files are returned as absolute paths, ``~`` unfolded.

    Raises:
        InvalidValueError: naming argument, value and bound; also for a bag that exists and a file that does not.
    """
    values = {}
    for argument in arguments:
        text = texts.get(argument.name, argument.default).strip()
        if text:
            values[argument.name] = _value(argument.parameter, text)
    if values.get("composed") and not values["localization"]:
        raise InvalidValueError("composed", True, "false with localization:=false: there is no ekf to share a process")
    return values


def _value(parameter: Parameter, text: str) -> Any:
    name = parameter.name
    if parameter.type is bool:
        if text not in _BOOLEANS:
            raise InvalidValueError(name, text, "true or false")
        return _BOOLEANS[text]
    if parameter.type in (float, int):
        try:
            value = parameter.type(text)
        except ValueError:
            kind = "a number" if parameter.type is float else "a whole number"
            raise InvalidValueError(name, text, f"{kind}, {parameter.spec.bound()}") from None
        return checked(parameter, value)
    return _checked_text(name, checked(parameter, text))


def _checked_text(name: str, text: str) -> str:
    if name == "namespace" and not _NAMESPACE.fullmatch(text):
        raise InvalidValueError(name, text, "words of letters, digits and _ with / between them")
    if name == "frame_prefix" and not _FRAME_PREFIX.fullmatch(text):
        raise InvalidValueError(name, text, "letters, digits, _, - and /, without a leading /")
    if name not in ("parameters", "urdf", "bag"):
        return text
    path = Path(os.path.abspath(Path(text).expanduser()))
    if name == "bag" and os.path.lexists(path):
        raise InvalidValueError(name, text, "a folder that does not exist yet")
    if name != "bag" and not path.is_file():
        raise InvalidValueError(name, text, "an existing file")
    return str(path)
