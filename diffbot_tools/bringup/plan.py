"""The nodes that a launch file starts, as plain data, from the values of its arguments."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from diffbot_core.parameter_files import Section, read_sections

PACKAGE = "diffbot"
DISCOVERY_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
RELATIVE_TF = (("/tf", "tf"), ("/tf_static", "tf_static"))
"""Remappings that put TF into the namespace of the robot, as Nav2's launch files do."""


class NodePlan(NamedTuple):
    """One process that a launch file starts."""

    executable: str
    package: str = PACKAGE
    name: str = ""
    """Name of the node; empty: the executable's own, as with several nodes in one process."""
    namespace: str = ""
    files: tuple[str, ...] = ()
    """Parameter files."""
    parameters: Mapping[str, Any] = {}
    """These come after the files."""
    remappings: tuple[tuple[str, str], ...] = ()
    arguments: tuple[str, ...] = ()
    ros_arguments: tuple[str, ...] = ()
    required: bool = True
    """Its end ends the launch."""
    optional: bool = False
    """Left out, with a line in the log, if its package is not installed."""


_MEMBERS = {"robot": ("ekf", "controller"), "docking": ("dock_ekf", "dock_controller")}
"""Nodes of the processes that hold two."""


def plan(values: Mapping[str, Any], share: Path, *, simulate: bool) -> list[NodePlan]:
    """Return what to start, the recorder first, so that the bag misses nothing.

    Args:
        values: of the arguments, by name, as :func:`~diffbot_tools.bringup.arguments.parse` returns them.
        share: folder of this package's config, rviz and urdf.
        simulate: whether to start the plant.

    Raises:
        DiffbotError: in one line, if the parameter file cannot be read.
    """
    in_step = values.get("clock") == "lockstep"
    # Every step waits for its messages: none may be lost, and each needs an answer.
    reliable = {"reliable_inputs": True} if in_step else {}
    lockstep = {"publish_when_idle": True, **reliable} if in_step else {}
    preset = _given(values, preset="preset")
    stamped = _given(values, enable_stamped_cmd_vel="stamped_cmd_vel")
    prefix = _given(values, frame_prefix="frame_prefix")
    managed = prefix | _given(values, autostart="autostart")
    found = [("recorder", {"uri": values["bag"]})] if "bag" in values else []
    if values["composed"]:
        found.append(("robot", preset | stamped | managed | lockstep))
    else:
        found += [("ekf", managed | reliable)] if values["localization"] else []
        found.append(("controller", preset | stamped | managed | lockstep))
    if simulate:
        found.append(("plant", stamped | prefix | _plant_parameters(values)))
    file = parameter_file(values, share)
    sections = read_sections(file)
    time = {"use_sim_time": _uses_sim_time(values, simulate)}
    nodes = [
        NodePlan(
            executable=f"{kind}_node",
            # robot_node holds two nodes, which keep their names.
            name="" if kind == "robot" else kind,
            files=(str(file),) if _concerns(sections, kind) else (),
            parameters={**time, **parameters},
        )
        for kind, parameters in found
    ]
    if values["docking"]:
        files = (str(file),) if _concerns(sections, "docking") else ()
        nodes.append(NodePlan(executable="docking_node", files=files, parameters={**time, **managed, **stamped}))
    return [_in_namespace(node, values) for node in [*nodes, *_displays(values, share, time)]]


def _concerns(sections: list[Section], kind: str) -> bool:
    """Return whether one of the sections is for the process, or may be meant for it: the node itself then says so."""
    names = _MEMBERS.get(kind, (kind,))
    return any(one.node in (name, "*", "**") or one.is_nearly_for(name) for one in sections for name in names)


def parameter_file(values: Mapping[str, Any], share: Path) -> Path:
    """Return the parameter file of all nodes; arguments as of :func:`plan`."""
    return Path(values.get("parameters", share / "config" / "diffbot.yaml"))


def environment(values: Mapping[str, Any], outer: Mapping[str, str], *, simulate: bool) -> dict[str, str]:
    """Return the environment variables to set for the nodes.

    A robot is restricted on request only: it may be driven from another host. A simulated one obeys any cmd_vel and may
    own /clock, so that it stays on its host unless argument or environment say otherwise.

    Args:
        values: as for :func:`plan`.
        outer: environment of the launch.
        simulate: as for :func:`plan`.
    """
    chosen = values.get("discovery_range", "")
    if not chosen and simulate and not outer.get(DISCOVERY_RANGE):
        chosen = "localhost"
    return {DISCOVERY_RANGE: chosen.upper()} if chosen else {}


def _given(values: Mapping[str, Any], **argument_of: str) -> dict[str, Any]:
    """Return the parameters whose arguments have values; the others are left to parameter file and node."""
    return {parameter: values[name] for parameter, name in argument_of.items() if name in values}


def _plant_parameters(values: Mapping[str, Any]) -> dict[str, Any]:
    start = {f"initial_pose.{name}": values[name] for name in ("x", "y", "yaw") if name in values}
    same = _given(
        values, clock="clock", seed="seed", real_time_factor="real_time_factor", publish_clock="publish_clock"
    )
    # The plant makes the time that the others use, or follows that of another plant.
    return {**start, **same, "use_sim_time": not values.get("publish_clock", True)}


def _uses_sim_time(values: Mapping[str, Any], simulate: bool) -> bool:
    return values["clock"] != "wall" if simulate else bool(values["use_sim_time"])


def _displays(values: Mapping[str, Any], share: Path, time: dict[str, Any]) -> list[NodePlan]:
    nodes = []
    if values["description"]:
        urdf = Path(values.get("urdf", share / "urdf" / "diffbot.urdf"))
        description = {"robot_description": urdf.read_text(encoding="utf-8")}
        publisher = "robot_state_publisher"
        parameters = {**time, **description, **_given(values, frame_prefix="frame_prefix")}
        nodes.append(NodePlan(publisher, publisher, publisher, parameters=parameters, required=False, optional=True))
    if values["rviz"]:
        rviz = ("-d", str(share / "rviz" / "diffbot.rviz"))
        nodes.append(NodePlan("rviz2", "rviz2", "rviz2", parameters=time, arguments=rviz, required=False))
    return nodes


def _in_namespace(node: NodePlan, values: Mapping[str, Any]) -> NodePlan:
    return node._replace(
        namespace=values.get("namespace", ""),
        # Frames that carry a prefix are for a /tf that all robots share.
        remappings=() if "frame_prefix" in values else RELATIVE_TF,
        ros_arguments=("--log-level", values["log_level"]),
    )
