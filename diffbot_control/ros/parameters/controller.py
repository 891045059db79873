"""Parameters of the node ``controller``, named as in Nav2 and ros2_control where that fits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

from diffbot_control.goals.supervisor import SupervisorConfig
from diffbot_control.law.law import Law
from diffbot_control.law.registry import PRESETS, TUNED, resolve_law
from diffbot_control.law.switching import SwitchingLaw
from diffbot_core.endpoints import AUTO, TYPE_WORDS
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import PARTIAL, Spec, checked, parameters_of, variant
from diffbot_core.shared_parameters import PREFIX_TEXT, RELIABLE_TEXT, CommandSourceConfig, FaultConfig, LifecycleConfig

ALL, PATHS = "all", "follow_path"
"""Values of nav2_actions."""


class PoseFallback(NamedTuple):
    """Uncertainty of a pose whose covariance is all zero, i.e. unknown.

    The defaults are a fifth of the default tolerances. With errors up to 0.05 m and 0.05 rad, the probability of being
    within the tolerances is then 0.99 (``reached_probability``), so goals can be reached. With narrower tolerances, the
    status may be ``tolerance below uncertainty`` until these parameters have the true values.
    """

    pose_sigma_xy: Annotated[
        float, Spec("standard deviation of the position of a pose without covariance (all zero)", "m", 1e-4, 1e3)
    ] = 0.02
    pose_sigma_yaw: Annotated[
        float, Spec("standard deviation of the heading of a pose without covariance (all zero)", "rad", 1e-4, 1e3)
    ] = 0.02


class ControllerNodeConfig(NamedTuple):
    """Parameters of the node ``controller`` with the law ``switching``; see :func:`parameter_set_of` for other laws."""

    law: Annotated[
        str,
        Spec("registered name of the law, or package.module:Class; by default the law of the preset", read_only=True),
    ] = SwitchingLaw.name
    preset: Annotated[
        str, Spec("set of defaults for the other parameters, with its law", choices=tuple(PRESETS), read_only=True)
    ] = TUNED
    supervisor: SupervisorConfig = SupervisorConfig()
    pose_source: Annotated[
        str,
        Spec(
            "source of the robot's pose: the topic pose or the topic odometry/filtered",
            choices=("pose", "odometry"),
            read_only=True,
        ),
    ] = "pose"
    pose_fallback: PoseFallback = PoseFallback()
    map_frame: Annotated[str, Spec("frame of poses and goals", read_only=True)] = "map"
    base_link_frame: Annotated[
        str, Spec("frame of the stamped command; child frame of odometry/filtered", read_only=True)
    ] = "base_link"
    frame_prefix: Annotated[str, Spec(PREFIX_TEXT, read_only=True)] = ""
    transform_tolerance: Annotated[
        float,
        Spec(
            "largest time by which the newest transform may be older than the stamp of a goal in another frame",
            "s",
            minimum=0.0,
            maximum=60.0,
            read_only=True,
        ),
    ] = 0.3
    reliable_inputs: Annotated[bool, Spec(RELIABLE_TEXT, read_only=True)] = False
    cmd_vel_type: Annotated[
        str,
        Spec(
            "type of the commands; auto: the type to which the base subscribes, and no commands without a base",
            choices=(AUTO, *TYPE_WORDS.values()),
            read_only=True,
        ),
    ] = AUTO
    nav2_actions: Annotated[
        str,
        Spec(
            "Nav2's actions to serve; follow_path: only this one, for use with Nav2's bt_navigator",
            choices=(ALL, PATHS),
            read_only=True,
        ),
    ] = ALL
    commands: CommandSourceConfig = CommandSourceConfig()
    lifecycle: LifecycleConfig = LifecycleConfig()
    faults: FaultConfig = FaultConfig()


_KINDS = (float, int, bool, str, tuple[float, ...], tuple[str, ...])
_ROS_NAMES = ("use_sim_time",)
"""Names of parameters that every node has."""


def parameter_set_of(overrides: Mapping[str, Any]) -> tuple[type[Any], Mapping[str, Any] | None]:
    """Return configuration type and presets of the node, for the law or the preset that ``overrides`` select.

    The parameters include the fields of the law's ``Config`` that carry a Spec. A preset selects its law.

    Raises:
        InvalidValueError: if the law or the preset does not exist, the law cannot be used, or the preset belongs to
            another law.
    """
    law_parameter, preset_parameter = parameters_of(ControllerNodeConfig)[:2]
    preset = checked(preset_parameter, overrides.get("preset", preset_parameter.default))
    text = checked(law_parameter, overrides.get("law", PRESETS[preset].law.name))
    law = resolve_law(text)
    presets = {name: one for name, one in PRESETS.items() if one.law is law}
    if "preset" in overrides and preset not in presets:
        raise InvalidValueError("preset", preset, f"a preset of the law {text}: {', '.join(presets) or 'it has none'}")
    config_type = _type_with(text, law, () if presets else ("preset",))
    base = config_type()._replace(law=text)
    found = {
        name: base._replace(preset=name, supervisor=base.supervisor._replace(controller=one.config))
        for name, one in presets.items()
    }
    defaults = {"law": text} | ({"preset": next(iter(found))} if found else {})
    return variant(config_type, {}, values=defaults), found or None


def _type_with(text: str, law: type[Law], without: tuple[str, ...]) -> type[Any]:
    """Return the node's configuration type with the parameters of a law.

    Raises:
        InvalidValueError: if the parameters of the law cannot be used.
    """
    try:
        supervisor = variant(SupervisorConfig, {"controller": Annotated[law.Config, PARTIAL]})
        config_type = variant(ControllerNodeConfig, {"supervisor": supervisor}, without)
        found = parameters_of(config_type)
    except Exception as error:  # names used twice, annotations that do not resolve, ...
        cause = " ".join(f"{type(error).__name__}: {error}".split())
        raise InvalidValueError("law", text, f"a law with usable parameters ({cause})") from None
    for one in found:
        if one.type not in _KINDS:
            raise InvalidValueError(
                "law", text, f"a law whose parameters are numbers, booleans or texts; {one.name} is not"
            )
        if one.name in _ROS_NAMES:
            raise InvalidValueError("law", text, f"a law without a parameter {one.name}, because every node has one")
    return config_type


CONTROLLER_PRESETS = {name: (parameter_set_of({"preset": name})[1] or {})[name] for name in PRESETS}
"""The sets of defaults that the parameter ``preset`` selects."""
