"""Processes of the launch files as plain data, and the check that a controller has the limits of its robot."""

from __future__ import annotations

import itertools
import os
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from diffbot_control.law.registry import PRESETS
from diffbot_control.ros.parameters.controller import ControllerNodeConfig
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.files import expanded, read_text
from diffbot_core.schema import parameters_of, to_dict
from diffbot_core.yaml_files import MAX_BYTES, WILDCARDS, Section, load_yaml, read_sections, values_for
from diffbot_sim.parameters import PlantNodeConfig

PACKAGE = "diffbot"
DISCOVERY_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
RELATIVE_TF = (("/tf", "tf"), ("/tf_static", "tf_static"))
"""Remappings that put TF into the namespace of the robot, as Nav2's launch files do."""
REQUIRED = (
    "linear.x.max_velocity",
    "angular.z.max_velocity",
    "linear.x.max_acceleration",
    "angular.z.max_acceleration",
)
"""Limits of a robot. By default they are the limits of the paper's robot, or infinite."""
CONTROLLER, EKF, PLANT = "controller", "ekf", "plant"
DOCK_CONTROLLER = "dock_controller"
CONTROLLERS = CONTROLLER, DOCK_CONTROLLER
"""Nodes that drive the robot."""
# In lock-step, a lost message would stop the graph, and a command must have the stamp of its step.
_FILTER: dict[str, Any] = {"reliable_inputs": True}
_DRIVER: dict[str, Any] = {"reliable_inputs": True, "cmd_vel_type": "twist_stamped", "publish_when_idle": True}
LOCKSTEP: dict[str, dict[str, Any]] = {
    EKF: _FILTER,
    CONTROLLER: _DRIVER,
    "dock_ekf": _FILTER,
    DOCK_CONTROLLER: _DRIVER,
    PLANT: {"cmd_vel_type": "twist_stamped"},
}
"""Parameters of each node that lock-step requires."""
_BOOLEAN = ("true", "false")
_PATHS = "parameters", "urdf", "bag"
_MEMBERS = {"robot": ("ekf", "controller"), "docking": ("dock_ekf", DOCK_CONTROLLER)}
"""Nodes of each process that runs two nodes."""
_PUBLISHERS, _WATCHERS = "max_cmd_vel_publishers", ("robot", CONTROLLER, PLANT)
"""Number of controllers on cmd_vel, and the processes that report more. docking_node expects two by itself."""


class Argument(NamedTuple):
    """One argument of a launch file; on the command line its value is a text."""

    name: str
    text: str
    default: str = ""
    """If empty, the parameter file or the node sets the value."""
    choices: tuple[str, ...] = ()
    is_number: bool = False


_COMMON = (
    Argument("namespace", "namespace of the robot; robots are launched one by one, each with its own namespace"),
    Argument("frame_prefix", "prefix of the robot's frames, e.g. robot1/; robots with prefixes share /tf"),
    Argument("parameters", "parameter file of all nodes (default: config/diffbot.yaml of this package)"),
    Argument("preset", "preset of the controller", choices=tuple(PRESETS)),
    Argument("localization", "start the ekf; false if another localization publishes the pose", "true", _BOOLEAN),
    Argument("composed", "run ekf and controller in one process, robot_node", "false", _BOOLEAN),
    Argument("autostart", "false: a lifecycle manager activates ekf, controller and docking", "", _BOOLEAN),
    Argument("docking", "start docking_node", "false", _BOOLEAN),
    Argument("cmd_vel_type", "type of the commands", choices=("auto", "twist", "twist_stamped")),
    Argument("bag", "record everything into this folder, which must not exist"),
    Argument("discovery_range", f"value of {DISCOVERY_RANGE}", "", ("localhost", "subnet", "off", "system_default")),
    Argument("log_level", "smallest level that is logged", "info", ("debug", "info", "warn", "error", "fatal")),
    Argument("rviz", "start RViz", "false", _BOOLEAN),
    Argument("urdf", "description of the robot (default: urdf/diffbot.urdf of this package)"),
)
ROBOT = (
    *_COMMON,
    Argument("description", "start robot_state_publisher, if it is installed", "false", _BOOLEAN),
    Argument("use_sim_time", "use the time of /clock, for a replayed bag or another simulator", "false", _BOOLEAN),
)
"""Arguments of robot.launch.py."""
SIMULATION = (
    *_COMMON,
    Argument("description", "start robot_state_publisher, if it is installed", "true", _BOOLEAN),
    Argument("x", "start position [m]", is_number=True),
    Argument("y", "start position [m]", is_number=True),
    Argument("yaw", "start heading [rad]", is_number=True),
    Argument("seed", "seed of all noise", is_number=True),
    Argument("clock", "source of time", "wall", ("wall", "scaled", "lockstep")),
    Argument("real_time_factor", "speed of the clock with clock:=scaled; 1 is real time", is_number=True),
)
"""Arguments of simulation.launch.py."""


class NodePlan(NamedTuple):
    """One process that a launch file starts."""

    executable: str
    package: str = PACKAGE
    name: str = ""
    """Name of the node; empty if the executable names its nodes."""
    namespace: str = ""
    files: tuple[str, ...] = ()
    """Parameter files."""
    parameters: Mapping[str, Any] = {}
    """Single parameters, which override the files."""
    remappings: tuple[tuple[str, str], ...] = ()
    arguments: tuple[str, ...] = ()
    ros_arguments: tuple[str, ...] = ()
    required: bool = True
    """The end of this process ends the launch."""
    optional: bool = False
    """If its package is not installed, the process is skipped with a log line."""


def parse(arguments: Sequence[Argument], texts: Mapping[str, str]) -> dict[str, Any]:
    """Return the value of each argument that is given or has a default, by the name of the argument.

    Paths are made absolute. The nodes check numbers, names and the folder of a bag later.

    Raises:
        DiffbotError: if a number cannot be parsed, or two arguments exclude each other.
    """
    values: dict[str, Any] = {}
    for one in arguments:
        text = texts.get(one.name, one.default).strip()
        if not text:
            continue
        if one.choices == _BOOLEAN:
            values[one.name] = text == "true"
        elif one.is_number:
            values[one.name] = load_yaml(text, one.name)
        elif one.name in _PATHS:
            values[one.name] = os.path.abspath(expanded(text))
        else:
            values[one.name] = text
    if values["composed"] and not values["localization"]:
        raise InvalidValueError("composed", True, "false with localization:=false, since robot_node runs the ekf")
    if "urdf" in values and not values["description"]:
        raise InvalidValueError("urdf", values["urdf"], "given with description:=true, which shows the robot")
    return values


def plan(values: Mapping[str, Any], share: Path, *, simulate: bool) -> list[NodePlan]:
    """Return the processes to start, the recorder first, so that the bag misses nothing.

    Args:
        values: values of the arguments, from :func:`parse`.
        share: folder of this package's config, rviz and urdf.
        simulate: start the plant.

    Raises:
        DiffbotError: if a file cannot be read.
    """
    time = {"use_sim_time": values["clock"] != "wall" if simulate else values["use_sim_time"]}
    file = parameter_file(values, share)
    sections = read_sections(file)
    is_given = any(_PUBLISHERS in one.values for one in sections)
    two = {_PUBLISHERS: len(CONTROLLERS)} if values["docking"] and not is_given else {}
    nodes = [
        NodePlan(
            executable=f"{process}_node",
            name="" if process in _MEMBERS else process,
            files=(str(file),) if _is_for(sections, process) else (),
            parameters={**time, **(two if process in _WATCHERS else {}), **parameters},
        )
        for process, parameters in _parameters(values, simulate=simulate).items()
    ]
    nodes += _viewers(values, share, time)
    # Frames with a prefix are distinct, so that all robots can share /tf.
    remappings = () if "frame_prefix" in values else RELATIVE_TF
    options = {"namespace": values.get("namespace", ""), "ros_arguments": ("--log-level", values["log_level"])}
    # A recorder with these rules would record the TF of this robot under the name /tf.
    return [node._replace(remappings=() if node.name == "recorder" else remappings, **options) for node in nodes]


def _parameters(values: Mapping[str, Any], *, simulate: bool) -> dict[str, dict[str, Any]]:
    """Return the parameters of each process of this package, in the order of starting."""
    lockstep, common = dict[str, dict[str, Any]](), _given(values, "frame_prefix", "autostart")
    if values.get("clock") == "lockstep":
        lockstep = lockstep_parameters((EKF, CONTROLLER, PLANT, *(_MEMBERS["docking"] if values["docking"] else ())))
    typed = _given(values, "cmd_vel_type")
    controller = {**_given(values, "preset"), **common, **lockstep.get(CONTROLLER, {}), **typed}
    found: dict[str, dict[str, Any]] = {}
    if "bag" in values:
        found["recorder"] = {"uri": values["bag"]}
    if values["composed"]:
        found["robot"] = controller
    else:
        if values["localization"]:
            found["ekf"] = {**common, **lockstep.get(EKF, {})}
        found["controller"] = controller
    if simulate:
        start = {f"initial_pose.{name}": values[name] for name in ("x", "y", "yaw") if name in values}
        plant = _given(values, "frame_prefix", "clock", "seed", "real_time_factor")
        # The plant publishes the time that the other nodes use.
        found["plant"] = {**lockstep.get(PLANT, {}), **typed, **plant, **start, "use_sim_time": False}
    if values["docking"]:
        found["docking"] = {**common, **typed}
    return found


def lockstep_parameters(nodes: Collection[str]) -> dict[str, dict[str, Any]]:
    """Return the parameters that lock-step requires, by the names of the ``nodes``.

    Raises:
        InvalidValueError: if two of the nodes publish cmd_vel: the plant would use the command that arrives first.
    """
    if set(CONTROLLERS).issubset(nodes):
        text = "in lock-step only one node may publish cmd_vel, not both controller and dock_controller"
        raise InvalidValueError("clock", "lockstep", sentence=text)
    return {node: LOCKSTEP[node] for node in nodes if node in LOCKSTEP}


def _is_for(sections: Sequence[Section], process: str) -> bool:
    """True if a section is for a node of a process. A misspelt name counts, so that the node gets and reports it."""
    names = _MEMBERS.get(process, (process,))
    return any(one.node in (name, *WILDCARDS) or one.is_nearly_for(name) for one in sections for name in names)


def _viewers(values: Mapping[str, Any], share: Path, time: Mapping[str, Any]) -> list[NodePlan]:
    """Return robot_state_publisher and RViz, if they are requested; ``time`` is their parameter use_sim_time."""
    nodes = []
    if values["description"]:
        urdf = Path(values.get("urdf", share / "urdf" / "diffbot.urdf"))
        parameters = {**time, "robot_description": read_text(urdf, MAX_BYTES), **_given(values, "frame_prefix")}
        name = "robot_state_publisher"
        nodes.append(NodePlan(name, name, name, parameters=parameters, required=False, optional=True))
    if values["rviz"]:
        rviz = ("-d", str(share / "rviz" / "diffbot.rviz"))
        nodes.append(NodePlan("rviz2", "rviz2", "rviz2", parameters=dict(time), arguments=rviz, required=False))
    return nodes


def parameter_file(values: Mapping[str, Any], share: Path) -> Path:
    """Return the parameter file of all nodes: the given file, or the one in the folder ``share`` of this package."""
    return Path(values.get("parameters", share / "config" / "diffbot.yaml"))


def environment(values: Mapping[str, Any], outer: Mapping[str, str], *, simulate: bool) -> dict[str, str]:
    """Return the environment variables to set for the nodes.

    By default, other hosts can discover a real robot, since one of them may drive it. They cannot discover a simulated
    robot, which obeys any cmd_vel and may publish /clock. The argument ``discovery_range``, and for a simulation the
    environment of the launch (``outer``), override the default.
    """
    chosen = values.get("discovery_range", "")
    if not chosen and simulate and not outer.get(DISCOVERY_RANGE):
        chosen = "localhost"
    return {DISCOVERY_RANGE: chosen.upper()} if chosen else {}


def _given(values: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: values[name] for name in names if name in values}


def check_data_sheet(file: Path, node: str = CONTROLLER) -> None:
    """Refuse a parameter file that lacks limits of the robot in the section of a controller.

    Raises:
        DiffbotError: naming the file and the missing parameters, or if the file cannot be read.
    """
    values = values_for(file, node)
    if missing := [name for name in REQUIRED if name not in values]:
        raise DiffbotError(
            f"{file}: /**/{node} lacks {', '.join(missing)}: a real robot is not driven without its limits"
        )


def check_limits(nodes: Collection[str], ros_arguments: Sequence[str]) -> None:
    """Refuse a controller without the limits of its robot: it would use the limits of the paper's robot.

    A controller that drives a plant with the same data sheet is not refused. Without any parameter file, only a warning
    is printed.

    Args:
        nodes: names of the nodes in the process.
        ros_arguments: ROS arguments of the process, without ``--ros-args``.

    Raises:
        DiffbotError: if limits are missing, or a file cannot be read.
    """
    for node in CONTROLLERS:
        if node in nodes:
            _check_limits_of(node, nodes, ros_arguments)


def _check_limits_of(node: str, nodes: Collection[str], ros_arguments: Sequence[str]) -> None:
    given = _values_given(node, ros_arguments)
    missing = [name for name in REQUIRED if name not in given]
    if not missing:
        return
    reason = "no plant runs in this process (--with plant)"
    if PLANT in nodes:
        plant = to_dict(PlantNodeConfig()) | _values_given(PLANT, ros_arguments)
        # Without a section for the controller, the section of the ekf may still give the wheels.
        robot = to_dict(ControllerNodeConfig()) | _values_given(EKF, ros_arguments) | given
        names = [one.name for one in parameters_of(DataSheet) if one.name in plant]
        different = [f"{name} {robot[name]} and {plant[name]}" for name in names if robot[name] != plant[name]]
        if not different:
            return
        reason = f"the plant has another data sheet: {', '.join(different)}"
    if "--params-file" not in ros_arguments:
        limits = to_dict(ControllerNodeConfig()) | given
        used = ", ".join(f"{name} {limits[name]:g}" for name in missing)
        print(f"diffbot: no --params-file describes the robot: it is driven with {used}", file=sys.stderr, flush=True)
        return
    raise DiffbotError(
        f"the {node} has no {', '.join(missing)}, and {reason}. A robot is not driven without its limits: give "
        "them in the section /** of a --params-file, as the file of `diffbot robot new` does"
    )


def relative_tf(nodes: Collection[str], ros_arguments: Sequence[str]) -> list[str]:
    """Return ROS arguments that put TF into the namespace of the robot, as the launch files do; none with frame_prefix.

    Arguments as for :func:`check_limits`. Recorder and replay keep the names of all topics.
    """
    robots = [node for node in nodes if node not in ("recorder", "replay")]
    if any(_values_given(node, ros_arguments).get("frame_prefix") for node in robots):
        return []
    return [word for node in robots for old, new in RELATIVE_TF for word in ("-r", f"{node}:{old}:={new}")]


def _values_given(node: str, words: Sequence[str]) -> dict[str, Any]:
    """Return the parameters that files and ``-p`` arguments give a node; ``-p`` overrides files, as in rcl."""
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
    """Return the full name of a node after remapping."""
    namespace, name = "", node
    for flag, value in itertools.pairwise(words):
        target, _, new = value.partition(":=")
        scope, _, what = target.rpartition(":")
        if flag in ("-r", "--remap") and scope in ("", node):
            namespace = new.rstrip("/") if what == "__ns" else namespace
            name = new if what in ("__node", "__name") else name
    return f"{namespace}/{name}"
