"""Launch descriptions of the planned processes; the only module that imports launch and launch_ros."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix, get_package_share_directory
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from diffbot_core.errors import DiffbotError
from diffbot_tools.bringup import (
    CONTROLLERS,
    PACKAGE,
    ROBOT,
    SIMULATION,
    Argument,
    NodePlan,
    check_data_sheet,
    environment,
    parameter_file,
    parse,
    plan,
)
from launch import LaunchContext, LaunchDescription


def robot() -> LaunchDescription:
    """Return the launch description of robot.launch.py."""
    return _description(ROBOT, simulate=False)


def simulation() -> LaunchDescription:
    """Return the launch description of simulation.launch.py."""
    return _description(SIMULATION, simulate=True)


def _description(arguments: tuple[Argument, ...], *, simulate: bool) -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(one.name, default_value=one.default, description=one.text, choices=_choices(one))
        for one in arguments
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=partial(_actions, arguments, simulate))])


def _choices(argument: Argument) -> list[str] | None:
    """Return the texts that launch accepts; None if it accepts any text."""
    # An argument without a default is empty if it is not given.
    return [*([] if argument.default else [""]), *argument.choices] if argument.choices else None


def _actions(arguments: tuple[Argument, ...], simulate: bool, context: LaunchContext) -> list[Any]:
    """Return the actions for the values of the arguments; launch reports an exception in one line and starts nothing.

    Raises:
        DiffbotError: if a package is not installed, a file cannot be read, or the limits of a real robot are missing.
    """
    texts = {one.name: LaunchConfiguration(one.name).perform(context) for one in arguments}
    share = Path(get_package_share_directory(PACKAGE))
    values = parse(arguments, texts)
    nodes = plan(values, share, simulate=simulate)
    for node in nodes:
        # launch itself would detect this only after it has started other nodes, and would not stop them.
        if not node.optional and not _is_installed(node.package):
            raise DiffbotError(f"the package {node.package} is not installed")
    if not simulate:
        for controller in CONTROLLERS if values["docking"] else CONTROLLERS[:1]:
            check_data_sheet(parameter_file(values, share), controller)
    variables = environment(values, os.environ, simulate=simulate)
    settings = [SetEnvironmentVariable(name, value) for name, value in variables.items()]
    notes = [LogInfo(msg=f"{name}={value}") for name, value in variables.items()]
    return [*notes, *settings, *map(_action, nodes)]


def _action(node: NodePlan) -> Any:
    if node.optional and not _is_installed(node.package):
        return LogInfo(msg=f"the package {node.package} is not installed: not starting {node.executable}")
    return Node(
        package=node.package,
        executable=node.executable,
        name=node.name or None,
        namespace=node.namespace,
        parameters=[*node.files, {name: _verbatim(value) for name, value in node.parameters.items()}],
        remappings=list(node.remappings),
        arguments=list(node.arguments),
        ros_arguments=list(node.ros_arguments),
        on_exit=_on_exit(node.executable) if node.required else None,
        output="screen",
    )


def _verbatim(value: Any) -> Any:
    """Return a parameter for launch_ros, which would parse a text as YAML: the name 2026 of a bag as a number."""
    return ParameterValue(value, value_type=str) if isinstance(value, str) else value


def _is_installed(package: str) -> bool:
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


def _on_exit(executable: str) -> Callable[[Any, LaunchContext], None]:
    """Return a handler for the end of a required node, which ends the launch with this reason and status 1."""

    def end(event: Any, context: LaunchContext) -> None:
        if not context.is_shutdown:
            raise DiffbotError(f"{executable} ended with exit code {event.returncode}, so everything is shut down")

    return end
