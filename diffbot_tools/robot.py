"""The configurations of a robot's nodes, read from its parameter file, without ROS."""

from __future__ import annotations

from os import PathLike
from typing import Any, NamedTuple

from diffbot_control.filter.config import LocalizationConfig
from diffbot_control.goals import SupervisorConfig
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.law import Law
from diffbot_control.law.registry import resolve_law
from diffbot_control.ros.parameters.controller import parameter_set_of
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import DiffbotError, InvalidValueError, known_name
from diffbot_core.files import expanded
from diffbot_core.schema import build, to_dict
from diffbot_core.yaml_files import PARAMETERS, load_yaml, values_for
from diffbot_sim.config import StartPose, WorldConfig
from diffbot_sim.parameters import PlantNodeConfig
from diffbot_sim.simulation import ClosedLoop
from diffbot_tools.parameter_file import values_of
from diffbot_tools.robot_description import PRESETS, RobotDescription, file_of_robot

NODES = "controller", "ekf", "plant"
Values = dict[str, dict[str, Any]]
"""Parameters of each node, by the name of the node."""


class RobotConfig(NamedTuple):
    """The configurations of a robot's nodes."""

    name: str
    controller: Any
    """configuration of the controller node, whose type depends on the law"""
    ekf: EkfNodeConfig
    plant: PlantNodeConfig
    given: Values
    """parameters of each node in the file; for the controller also those of laws that it does not run"""

    def __repr__(self) -> str:
        """Return the name and the most important values in one line."""
        sheet, tolerance = self.data_sheet, self.tolerance
        return (
            f"<Robot {self.name}: {sheet.v_max:g} m/s, {sheet.omega_max:g} rad/s, latency {sheet.command_latency:g} s, "
            f"tolerances {tolerance.xy_goal_tolerance:g} m and {tolerance.yaw_goal_tolerance:g} rad>"
        )

    @property
    def tolerance(self) -> GoalTolerance:
        """Tolerances of the law."""
        return self.law.tolerance(self.controller.supervisor.controller)

    @property
    def data_sheet(self) -> DataSheet:
        """Data sheet of the law."""
        return self.law.data_sheet(self.controller.supervisor.controller)

    @property
    def law(self) -> type[Law]:
        """Law that drives the robot."""
        return resolve_law(self.controller.law)

    def parts(
        self, seed: int = 1, start: StartPose | None = None
    ) -> tuple[WorldConfig, LocalizationConfig, SupervisorConfig, type[Law]]:
        """Return the arguments of a simulation; ``start`` is by default the start pose of the plant."""
        world = self.plant.world._replace(seed=seed)
        world = world if start is None else world._replace(start=start)
        return world, self.ekf.localization, self.controller.supervisor, self.law

    def simulation(self, seed: int = 1) -> ClosedLoop:
        """Return a simulation of the robot, at rest at its start pose."""
        return ClosedLoop(*self.parts(seed))


def read_robot(source: str | PathLike[str] | RobotDescription) -> RobotConfig:
    """Return the robot that a parameter file, the name of a preset or a description describes.

    Raises:
        DiffbotError: if the file, the preset or a section is missing, or a value is not allowed.
    """
    if isinstance(source, RobotDescription):
        return _of_description(source, "robot")
    if str(source) in PRESETS:
        return _of_description(PRESETS[str(source)], str(source))
    path = expanded(source)
    if not path.suffix and not path.exists():
        raise InvalidValueError("robot", str(source), f"a parameter file or {known_name(str(source), PRESETS)}")
    values = {node: values_for(path, node) for node in NODES}
    try:
        return make_robot(path.stem, values)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from error


def _of_description(description: RobotDescription, name: str) -> RobotConfig:
    content = load_yaml(file_of_robot(build(RobotDescription, to_dict(description))), name, unique_keys=True)
    values = {section: one[PARAMETERS] for section, one in content.items()}
    return make_robot(name, {node: values["/**"] | values[f"/**/{node}"] for node in NODES})


def make_robot(name: str, values: Values) -> RobotConfig:
    """Return the robot with these parameters. As in the nodes, parameters of other nodes are ignored.

    Raises:
        DiffbotError: if a value is not allowed, or no node knows a name.
    """
    controller_type, presets = parameter_set_of(values["controller"])
    types = {"controller": controller_type, "ekf": EkfNodeConfig, "plant": PlantNodeConfig}
    own = {node: values_of(values[node], kind) for node, kind in types.items()}
    base = presets[str(values["controller"].get("preset", next(iter(presets))))] if presets else None
    return RobotConfig(
        name,
        build(controller_type, own["controller"], base),
        build(EkfNodeConfig, own["ekf"]),
        build(PlantNodeConfig, own["plant"]),
        own | {"controller": values["controller"]},
    )
