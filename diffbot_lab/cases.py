"""Build cases of the compiled loop from configurations or from values of parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.config import FilterConfig, LocalizationConfig, options_of
from diffbot_control.law.configuration import SwitchingConfig
from diffbot_control.law.law import Law
from diffbot_control.law.registry import PRESETS
from diffbot_control.law.switching import SwitchingLaw
from diffbot_core.errors import InvalidValueError, known_name
from diffbot_core.geometry import Pose
from diffbot_core.schema import build, parameters_of, to_dict
from diffbot_sim.config import PlantConfig, SensorConfig
from diffbot_sim.fusion import SimulatedRobot
from diffbot_sim.robot_step import FEEDBACKS, Case

_NO_LANDMARKS = np.empty((0, 2))


class Configuration(NamedTuple):
    """Plant, sensors, controller and filter of a run."""

    plant: PlantConfig = PlantConfig()
    sensors: SensorConfig = SensorConfig()
    controller: Any = SwitchingConfig()
    """an instance of the law's Config"""
    filter: FilterConfig = FilterConfig()


def law_of(name: str, values: Mapping[str, Any]) -> str:
    """Return the name of the law to run: ``name``, or the law of the ``preset`` in ``values`` for the switching law.

    Raises:
        InvalidValueError: for an unknown preset.
    """
    preset = values.get("preset")
    if preset is None or name != SwitchingLaw.name:
        return name
    if str(preset) not in PRESETS:
        raise InvalidValueError("preset", preset, known_name(preset, PRESETS))
    return PRESETS[preset].law.name


def configure(values: Mapping[str, Any], law: type[Law] = SwitchingLaw) -> Configuration:
    """Build the configurations from values of parameters.

    A value sets the parameter of this name in every configuration that has it, so ``wheel_radius`` sets the radius of
    plant and controller. A ``preset`` replaces the defaults of the law.

    Raises:
        InvalidValueError: for an unknown name or a value that is not allowed.
    """
    values = dict(values)
    parts: tuple[type[Any], ...] = (PlantConfig, SensorConfig, law.Config, FilterConfig)
    preset = PRESETS.get(str(values.get("preset")))
    bases: dict[type[Any], Any] = {}
    if preset is not None and preset.law is law:
        del values["preset"]
        bases = {law.Config: preset.config}
    names = [{parameter.name for parameter in parameters_of(part)} for part in parts]
    for name, value in values.items():
        if not any(name in own for own in names):
            raise InvalidValueError(name, value, known_name(name, set().union(*names)))
    return Configuration(
        *(
            build(part, {name: value for name, value in values.items() if name in own}, bases.get(part))
            for part, own in zip(parts, names, strict=True)
        )
    )


def changes(config: tuple[Any, ...]) -> str:
    """Return a text that lists the values of a configuration that are not the default."""
    plain = to_dict(type(config)())
    changed = [f"{name} = {value}" for name, value in to_dict(config).items() if value != plain[name]]
    return f"not the default: {', '.join(changed) or 'nothing'}"


def described(name: str, **parts: tuple[Any, ...]) -> str:
    """Return a line with a name and, for each part of its configuration, the values that are not the default."""
    return f"{name}: " + "; ".join(f"{part} {changes(config)}" for part, config in parts.items())


def make_case(
    configuration: Configuration,
    duration: float,
    *,
    law: type[Law] = SwitchingLaw,
    feedback: str = "ekf",
    tolerance: tuple[float, float] | None = None,
    literal_rear: bool = False,
) -> Case:
    """Return a case with its goal at the origin and no landmarks.

    Args:
        configuration: plant, sensors, controller and filter.
        duration: [s] length of each run, rounded to whole steps, at least one step.
        law: the law; the controller's configuration is an instance of its Config.
        feedback: pose that the controller receives, one of FEEDBACKS.
        tolerance: [m], [rad] tolerances for the settling time; None for the law's tolerances.
        literal_rear: use the sign that the paper prints for the velocity in the rear sector.
    """
    plant, sensors, controller, filter_config = configuration
    stop = law.tolerance(controller)
    own = stop.xy_goal_tolerance, stop.yaw_goal_tolerance
    xy_tolerance, yaw_tolerance = own if tolerance is None else tolerance
    options = options_of(LocalizationConfig(filter=filter_config), plant.wheels.wheel_separation)
    return Case(
        SimulatedRobot(plant, sensors, options, _NO_LANDMARKS),
        controller,
        Pose(0.0, 0.0, 0.0),
        FEEDBACKS.index(feedback),
        literal_rear,
        max(1, round(duration / plant.sampling_time)),
        xy_tolerance,
        yaw_tolerance,
    )
