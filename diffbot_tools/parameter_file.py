"""Parameters of a node from a ROS parameter file, without ROS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diffbot_control.ros.parameters.controller import ControllerNodeConfig
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import DiffbotError, InvalidValueError, known_name
from diffbot_core.schema import build, parameters_of
from diffbot_core.yaml_files import values_for
from diffbot_sim.parameters import PlantNodeConfig

EKF = "ekf"


def read_config(path: Path) -> EkfNodeConfig:
    """Return the configuration of the node ``ekf`` in a parameter file, in any namespace.

    Raises:
        DiffbotError: if the file cannot be read, a section for ``ekf`` is missing, or a parameter is unknown or out of
            its bounds.
    """
    values = values_for(path, EKF)
    try:
        return build(EkfNodeConfig, values_of(values, EkfNodeConfig))
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from error


def values_of(values: Mapping[str, Any], config_type: type[Any]) -> dict[str, Any]:
    """Return the parameters of one node among ``values``, which may contain parameters of other nodes.

    Raises:
        InvalidValueError: if no node has a parameter of this name.
    """
    types = config_type, ControllerNodeConfig, EkfNodeConfig, PlantNodeConfig
    own, *others = ({one.name for one in parameters_of(kind)} for kind in types)
    known = own.union(*others, ["use_sim_time"])
    for name, value in values.items():
        if name not in known:
            raise InvalidValueError(name, value, known_name(name, known))
    return {name: value for name, value in values.items() if name in own}
