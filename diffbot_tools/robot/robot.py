"""A robot as its parameter file describes it: the configurations of the nodes, without ROS."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.goals import Law, SupervisorConfig, data_sheet_of, tolerance_of
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.ros.parameters.controller import ControllerNodeConfig, law_of, parameter_set_of
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.bounded_yaml import load_yaml
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import DiffbotError, InvalidValueError, known_name
from diffbot_core.parameter_files import PARAMETERS, values_for
from diffbot_core.schema import build
from diffbot_sim.drive import Simulation
from diffbot_sim.model.simulator import StartPose, WorldConfig
from diffbot_sim.ros.parameters import PlantNodeConfig
from diffbot_tools.refilter.parameters import values_of
from diffbot_tools.robot.description import PRESETS, RobotDescription, file_of_robot

Values = dict[str, dict[str, Any]]
"""Parameters by node: controller, ekf, plant."""


class Robot(NamedTuple):
    """What the nodes of a robot are configured with."""

    name: str
    controller: Any
    """of the node's Config under its law"""
    ekf: EkfNodeConfig
    plant: PlantNodeConfig
    given: Values
    """parameters that the description sets; of the controller also parameters that only other laws have"""

    @property
    def tolerance(self) -> GoalTolerance:
        """The tolerances of the law; the defaults if the law does not have any."""
        return tolerance_of(self.controller.supervisor.controller)

    @property
    def data_sheet(self) -> DataSheet:
        """The data sheet of the law; the default one if the law does not have any."""
        return data_sheet_of(self.controller.supervisor.controller) or DataSheet()

    def parts(
        self, seed: int = 1, start: StartPose | None = None
    ) -> tuple[WorldConfig, LocalizationConfig, SupervisorConfig, Law]:
        """Return what a simulation is made of; ``seed`` names the noise, without ``start`` the plant's own holds."""
        world = self.plant.simulated()._replace(seed=seed)
        world = world if start is None else world._replace(start=start)
        return world, self.ekf.localization, self.controller.supervisor, law_of(self.controller.law)

    def simulation(self, seed: int = 1) -> Simulation:
        """Return the robot at rest at its start."""
        return Simulation(*self.parts(seed))


def read_robot(source: str | PathLike[str] | RobotDescription) -> Robot:
    """Return the robot of a parameter file, of a preset's name, or of a description.

    Raises:
        DiffbotError: in one line, if there is no such file or preset, a section is missing, or a value not allowed.
    """
    if isinstance(source, RobotDescription):
        return _of_description(source, "robot")
    if str(source) in PRESETS:
        return _of_description(PRESETS[str(source)], str(source))
    path = Path(source).expanduser()
    if not path.suffix and not path.exists():
        raise InvalidValueError("robot", str(source), f"a parameter file or {known_name(str(source), PRESETS)}")
    values = {node: values_for(path, node) for node in ("controller", "ekf", "plant")}
    try:
        return make_robot(path.stem, values)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from error


def _of_description(description: RobotDescription, name: str) -> Robot:
    content = load_yaml(file_of_robot(build(RobotDescription, description._asdict())), name, unique_keys=True)
    values = {section: one[PARAMETERS] for section, one in content.items()}
    return make_robot(name, {node: values["/**"] | values[f"/**/{node}"] for node in ("controller", "ekf", "plant")})


def make_robot(name: str, values: Values) -> Robot:
    """Return the robot with these parameters; as in the nodes, a parameter of another node is passed over.

    Raises:
        DiffbotError: for a value that is not allowed, or a name that no node knows.
    """
    controller_type, presets = parameter_set_of(values["controller"])
    types = {"controller": controller_type, "ekf": EkfNodeConfig, "plant": PlantNodeConfig}
    own = {node: values_of(values[node], kind) for node, kind in types.items()}
    base = (presets or {}).get(str(values["controller"].get("preset", ControllerNodeConfig().preset)))
    return Robot(
        name,
        build(controller_type, own["controller"], base),
        build(EkfNodeConfig, own["ekf"]),
        build(PlantNodeConfig, own["plant"]),
        own | {"controller": values["controller"]},
    )
