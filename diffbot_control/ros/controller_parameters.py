"""Parameters of the node ``controller``, named as in Nav2 and ros2_control where that fits."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.law.configuration import TANH, ControllerConfig
from diffbot_control.law.presets import PRESETS, TUNED
from diffbot_control.law.supervisor import SupervisorConfig
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import Uncertainty


class PoseFallback(NamedTuple):
    """Uncertainty of a pose whose covariance is all zero, i.e. unknown.

    The defaults are a fifth of the default tolerances, as a localisation good enough for such goals has at rest: two
    standard deviations (``goal_sigmas``) leave 0.06 m and 0.06 rad for the errors, so goals can be reached. With
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
    """Parameters of the node ``controller``."""

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
    map_frame: Annotated[str, Spec("frame of poses and goals", read_only=True)] = "map"
    base_link_frame: Annotated[
        str, Spec("frame of the stamped command; child frame of odometry/filtered", read_only=True)
    ] = "base_link"
    enable_stamped_cmd_vel: Annotated[bool, Spec("publish TwistStamped instead of Twist", read_only=True)] = False


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
