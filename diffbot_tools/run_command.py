"""The command ``diffbot run``: run one node, or several nodes in one process on one executor."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Iterator
from typing import Any, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.launcher import end_on_signals
from diffbot_tools.arguments import ros_parameters


class Entry(NamedTuple):
    """Module and factory of a node; the module is imported when the node runs."""

    module: str
    factory: str
    """name of a function in the module that returns a node, or an iterator over the ``members``"""
    members: tuple[str, ...] = ()
    """names of the nodes, if the factory returns several"""


NODES = {
    "robot": Entry("diffbot_control.robot_node", "make_nodes", ("ekf", "controller")),
    "ekf": Entry("diffbot_control.ekf_node", "EkfNode"),
    "controller": Entry("diffbot_control.controller_node", "ControllerNode"),
    "docking": Entry("diffbot_control.docking_node", "make_nodes", ("dock_ekf", "dock_controller")),
    "plant": Entry("diffbot_sim.plant_node", "PlantNode"),
    "replay": Entry("diffbot_bag.replay_node", "ReplayNode"),
    "recorder": Entry("diffbot_bag.recorder_node", "RecorderNode"),
}
"""Nodes in the order in which they start and stop in one process: the recorder closes its bag last."""


def add_run(commands: Any) -> None:
    """Add ``diffbot run`` to the subparsers of the command line."""
    run = commands.add_parser(
        "run",
        help="run one node as ros2 run does, or several nodes in one process",
        description="Run nodes in this process until a signal, or until one of them ends.",
    )
    run.add_argument("node", choices=sorted(NODES))
    run.add_argument(
        "--with",
        dest="others",
        nargs="+",
        choices=sorted(NODES),
        default=[],
        metavar="NODE",
        help=f"more nodes in the same process: {', '.join(sorted(NODES))}",
    )
    run.add_argument(
        "--ros-args",
        dest="ros_args",
        nargs=argparse.REMAINDER,
        default=[],
        help="parameters (--params-file FILE, -p NAME:=VALUE, -p NODE:NAME:=VALUE) and remappings",
    )
    run.set_defaults(call=lambda options: run_nodes([options.node, *options.others], options.ros_args))


def run_nodes(names: list[str], ros_args: list[str]) -> int:
    """Run the nodes in this process; return the exit status.

    Raises:
        DiffbotError: if a node is given twice, such as ekf and robot, or the controller lacks the limits of its robot.
    """
    members = [member for name in names for member in NODES[name].members or (name,)]
    for member in members:
        if members.count(member) > 1:
            raise InvalidValueError(
                "--with", " ".join(names[1:]), sentence=f"each node may appear only once; {member} appears twice"
            )
    # Imported by name, here and below, since the command line must start without ROS and heavy libraries.
    bringup = "diffbot_tools.bringup"
    if any(word.endswith("clock:=lockstep") for word in ros_args):
        needed = {"use_sim_time": True}
        for values in importlib.import_module(bringup).lockstep_parameters(members).values():
            needed.update(values)
        ros_args = [*ros_parameters(needed), *ros_args]
    end_on_signals(0)
    if "controller" in members or "dock_controller" in members:
        importlib.import_module(bringup).check_limits(members, ros_args)
    if any("__ns:=" in word for word in ros_args):
        # Last, since the first rule for a name applies.
        ros_args = [*ros_args, *importlib.import_module(bringup).relative_tf(members, ros_args)]
    entries = [entry for name, entry in NODES.items() if name in names]
    factories = [getattr(importlib.import_module(entry.module), entry.factory) for entry in entries]

    def make_nodes() -> Iterator[Any]:
        for entry, factory in zip(entries, factories, strict=True):
            if entry.members:
                yield from factory()
            else:
                yield factory()

    run = importlib.import_module("diffbot_core.ros.run").run
    # As in the main() of each node: a process that dies must not delay a node that drives.
    status: int = run(make_nodes, ["--ros-args", *ros_args], shared_memory={"recorder", "replay"}.issuperset(names))
    return status
