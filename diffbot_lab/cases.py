"""Cases of the compiled loop: parameters by name, and the one place that assembles a case from configurations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_control.law.controller import ControllerConfig
from diffbot_control.law.presets import PAPER, PRESETS
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.schema import build, parameters_of, refuse_replaced
from diffbot_sim.compiled.batch import FEEDBACK_CODES
from diffbot_sim.compiled.closed_loop import Case
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

ORIGIN = Pose(0.0, 0.0, 0.0)


class Configuration(NamedTuple):
    """Robot, sensors, controller and filter of a run."""

    plant: PlantConfig = PlantConfig()
    sensors: SensorConfig = SensorConfig()
    controller: ControllerConfig = ControllerConfig()
    filter: FilterConfig = FilterConfig()


_PARTS: tuple[type[Any], ...] = (PlantConfig, SensorConfig, ControllerConfig, FilterConfig)
"""types of the fields of :class:`Configuration`, in their order"""


def configure(values: Mapping[str, Any]) -> Configuration:
    """Build the configurations from parameter values; each value goes to every configuration that has its name.

    So ``wheel_radius`` sets the plant's and the controller's. ``preset`` selects the controller's defaults.

    Raises:
        InvalidValueError: for an unknown name or a value that is not allowed.
    """
    values = dict(values)
    preset = values.pop("preset", PAPER)
    if preset not in PRESETS:
        raise InvalidValueError("preset", preset, "one of " + ", ".join(PRESETS))
    for part in _PARTS:
        refuse_replaced(part, values)
    names = [{parameter.name for parameter in parameters_of(part)} for part in _PARTS]
    for name, value in values.items():
        if not any(name in own for own in names):
            raise InvalidValueError(name, value, f"a parameter: {', '.join(sorted(set().union(*names)))}")
    bases = {ControllerConfig: PRESETS[preset]}
    return Configuration(
        *(
            build(part, {name: value for name, value in values.items() if name in own}, bases.get(part))
            for part, own in zip(_PARTS, names, strict=True)
        )
    )


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
        tolerance: [m], [rad] within which a run has settled; None for the controller's own.
        literal_rear: use the sign that the paper prints for the velocity in the rear sector.
    """
    plant, sensors, controller, filter_config = configuration
    own = controller.tolerance.xy_goal_tolerance, controller.tolerance.yaw_goal_tolerance
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
