"""Parameters of the node ``controller``, named as in Nav2 and ros2_control where that fits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

from diffbot_control.goals.configuration import SupervisorConfig
from diffbot_control.goals.goal_record import MAX_PATH_POSES
from diffbot_control.goals.protocol import Law
from diffbot_control.law.configuration import TANH, ControllerConfig
from diffbot_control.law.controller import SwitchingLaw
from diffbot_control.law.presets import PRESETS, TUNED
from diffbot_control.ros.frames import PREFIX_TEXT, RELIABLE_TEXT
from diffbot_core.errors import InvalidValueError
from diffbot_core.ros.command_parameters import CommandSourceConfig
from diffbot_core.ros.fault_parameters import FaultConfig
from diffbot_core.ros.lifecycle_parameters import LifecycleConfig
from diffbot_core.schema import PARTIAL, Spec, checked, parameters_of, variant
from diffbot_core.uncertainty import Uncertainty


class PoseFallback(NamedTuple):
    """Uncertainty of a pose whose covariance is all zero, i.e. unknown.

    The defaults are a fifth of the default tolerances, as a localization good enough for such goals has at rest: errors
    up to 0.05 m and 0.05 rad leave a probability of 0.99 (``reached_probability``), so goals can be reached. With
    narrower tolerances the status may say ``tolerance below uncertainty`` until these parameters hold the true values.
    """

    pose_sigma_xy: Annotated[
        float, Spec("deviation of the position of a pose without covariance (all zero)", "m", minimum=1e-4, maximum=1e3)
    ] = 0.02
    pose_sigma_yaw: Annotated[
        float, Spec("deviation of the heading of a pose without covariance", "rad", minimum=1e-4, maximum=1e3)
    ] = 0.02

    def uncertainty(self) -> Uncertainty:
        """Return it as the controller takes it."""
        return Uncertainty(self.pose_sigma_xy, self.pose_sigma_yaw)


class ControllerNodeConfig(NamedTuple):
    """Parameters of the node ``controller``, of the law ``switching``; see :func:`parameter_set_of` for others."""

    law: Annotated[str, Spec("law that drives: a registered name, or package.module:Class", read_only=True)] = (
        SwitchingLaw.name
    )
    preset: Annotated[str, Spec("set of defaults for the other parameters", choices=tuple(PRESETS), read_only=True)] = (
        TUNED
    )
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
    real_timeout_factor: Annotated[
        float,
        Spec(
            "with use_sim_time, the robot is also stopped after this many pose_timeout of real time without a pose, or"
            " with /clock standing still; > 1 for a simulation slower than real time (publish_when_idle: never)",
            minimum=1.0,
            maximum=1e6,
            allow_inf=True,
        ),
    ] = 1.0
    map_frame: Annotated[str, Spec("frame of poses and goals", read_only=True)] = "map"
    base_link_frame: Annotated[
        str, Spec("frame of the stamped command; child frame of odometry/filtered", read_only=True)
    ] = "base_link"
    frame_prefix: Annotated[str, Spec(PREFIX_TEXT, read_only=True)] = ""
    transform_tolerance: Annotated[
        float,
        Spec(
            "how much older than a goal in another frame the newest transform may be",
            "s",
            minimum=0.0,
            maximum=60.0,
            read_only=True,
        ),
    ] = 0.3
    max_path_poses: Annotated[
        int, Spec("largest number of poses of a path; a longer path is refused", "-", 1, 1_000_000)
    ] = MAX_PATH_POSES
    reliable_inputs: Annotated[bool, Spec(RELIABLE_TEXT, read_only=True)] = False
    enable_stamped_cmd_vel: Annotated[bool, Spec("publish TwistStamped instead of Twist", read_only=True)] = False
    commands: CommandSourceConfig = CommandSourceConfig()
    lifecycle: LifecycleConfig = LifecycleConfig()
    faults: FaultConfig = FaultConfig()


def _supervisor_of(controller: ControllerConfig) -> SupervisorConfig:
    """Return the supervisor of a preset: the paper's law is never given up, as it was published."""
    if controller.profile == TANH:
        return SupervisorConfig(controller=controller, max_departures=0)
    return SupervisorConfig(controller=controller)


CONTROLLER_PRESETS = {
    name: ControllerNodeConfig(preset=name, supervisor=_supervisor_of(controller))
    for name, controller in PRESETS.items()
}
"""The sets of defaults that the parameter ``preset`` selects."""

_NOT_OF_OTHERS = ("preset", "max_departures")
"""Parameters that only this project's law has a meaning for."""
_KINDS = (float, int, bool, str, tuple[float, ...], tuple[str, ...])
_ROS_NAMES = ("use_sim_time",)
"""Parameters that every node has."""


def law_of(text: str) -> Law:
    """Return the law of the parameter ``law``.

    Raises:
        InvalidValueError: in one line, if there is none or it is unfit.
    """
    if text == SwitchingLaw.name:
        return SwitchingLaw
    # Not before it is needed: the entry points of all installed packages take time to read.
    from diffbot_control.goals.registry import resolve_law  # noqa: PLC0415

    return resolve_law(text)


def parameter_set_of(overrides: Mapping[str, Any]) -> tuple[type[Any], Mapping[str, Any] | None]:
    """Return configuration type and presets of the node for the law among its ``overrides``.

    Another law than this project's brings the fields of its ``Config`` that carry a Spec.

    Raises:
        InvalidValueError: in one line, if there is no such law, or it cannot be used.
    """
    parameter = next(one for one in parameters_of(ControllerNodeConfig) if one.name == "law")
    text = checked(parameter, overrides.get("law", parameter.default))
    law = law_of(text)
    if law is SwitchingLaw:
        return ControllerNodeConfig, CONTROLLER_PRESETS
    try:
        supervisor = variant(SupervisorConfig, {"controller": Annotated[law.Config, PARTIAL]}, _NOT_OF_OTHERS)
        config_type = variant(ControllerNodeConfig, {"supervisor": supervisor}, _NOT_OF_OTHERS)
        found = parameters_of(config_type)
    except Exception as error:  # names used twice, annotations that do not resolve, ...
        cause = " ".join(f"{type(error).__name__}: {error}".split())
        raise InvalidValueError("law", text, f"a law with usable parameters ({cause})") from None
    for one in found:
        if one.type not in _KINDS:
            raise InvalidValueError(
                "law", text, f"a law with numbers, booleans and texts as parameters, not {one.name}"
            )
        if one.name in _ROS_NAMES:
            raise InvalidValueError("law", text, f"a law without a parameter {one.name}, which every node has")
    return config_type, None
