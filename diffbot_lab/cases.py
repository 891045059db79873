"""Cases of the compiled loop: parameters by name, and the one place that assembles a case from configurations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_control.goals.protocol import Law
from diffbot_control.law.controller import ControllerConfig, SwitchingLaw
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.presets import PRESETS, TUNED
from diffbot_core.errors import InvalidValueError, known_name
from diffbot_core.geometry import Pose
from diffbot_core.schema import build, parameters_of, refuse_replaced, to_dict
from diffbot_sim.compiled.batch import FEEDBACK_CODES
from diffbot_sim.compiled.closed_loop import Case
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

ORIGIN = Pose(0.0, 0.0, 0.0)


class Configuration(NamedTuple):
    """Robot, sensors, controller and filter of a run."""

    plant: PlantConfig = PlantConfig()
    sensors: SensorConfig = SensorConfig()
    controller: Any = ControllerConfig()
    """of the Config of the law that drives"""
    filter: FilterConfig = FilterConfig()


def configure(values: Mapping[str, Any], law: Law = SwitchingLaw) -> Configuration:
    """Build the configurations from parameter values; each value goes to every configuration that has its name.

    So ``wheel_radius`` sets the plant's and the controller's. ``preset`` selects the defaults of this project's law;
    without it they are those of the node.

    Raises:
        InvalidValueError: for an unknown name or a value that is not allowed.
    """
    values = dict(values)
    parts: tuple[type[Any], ...] = (PlantConfig, SensorConfig, law.Config, FilterConfig)
    is_own = law.Config is ControllerConfig
    preset = values.pop("preset", TUNED) if is_own else TUNED
    if preset not in PRESETS:
        raise InvalidValueError("preset", preset, known_name(preset, PRESETS))
    for part in parts:
        refuse_replaced(part, values)
    names = [{parameter.name for parameter in parameters_of(part)} for part in parts]
    for name, value in values.items():
        if not any(name in own for own in names):
            raise InvalidValueError(name, value, known_name(name, set().union(*names)))
    bases: dict[type[Any], Any] = {ControllerConfig: PRESETS[preset]} if is_own else {}
    return Configuration(
        *(
            build(part, {name: value for name, value in values.items() if name in own}, bases.get(part))
            for part, own in zip(parts, names, strict=True)
        )
    )


def changes(config: tuple[Any, ...], base: tuple[Any, ...] | None = None) -> str:
    """Return the parameters in which a configuration differs from ``base``, by default the defaults, as a text."""
    plain = to_dict(type(config)() if base is None else base)
    changed = [f"{name} = {value}" for name, value in to_dict(config).items() if value != plain[name]]
    return f"not the default: {', '.join(changed) or 'nothing'}"


def described(name: str, **parts: tuple[Any, ...]) -> str:
    """Return a line that says what runs under a name: the parts of its configuration, with all not the default."""
    return f"{name}: " + "; ".join(f"{part} {changes(config)}" for part, config in parts.items())


def make_case(
    configuration: Configuration,
    duration: float,
    *,
    feedback: str = "ekf",
    goal: Pose = ORIGIN,
    tolerance: tuple[float, float] | None = None,
    literal_rear: bool = False,
) -> Case:
    """Assemble what the runs of one case share.

    Args:
        configuration: of plant, sensors, controller and filter.
        duration: [s] of each run, rounded to whole steps, at least one.
        feedback: one of FEEDBACK_CODES: which pose the controller receives.
        goal: [m, m, rad] in map.
        tolerance: [m], [rad] within which a run has settled; None for the law's own, if it has a ``tolerance``.
        literal_rear: use the sign that the paper prints for the velocity in the rear sector.
    """
    plant, sensors, controller, filter_config = configuration
    stop = getattr(controller, "tolerance", GoalTolerance())
    own = stop.xy_goal_tolerance, stop.yaw_goal_tolerance
    xy_tolerance, yaw_tolerance = own if tolerance is None else tolerance
    return Case(
        plant,
        sensors,
        controller,
        goal,
        FEEDBACK_CODES[feedback],
        literal_rear,
        max(1, round(duration / plant.sampling_time)),
        xy_tolerance,
        yaw_tolerance,
        filter=options_of(filter_config),
    )
