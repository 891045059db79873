"""Parameters of the node ``controller``, named as in Nav2 and ros2_control where that fits."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.law.presets import PRESETS, TUNED
from diffbot_control.law.supervisor import SupervisorConfig
from diffbot_core.schema import Spec


class ControllerNodeConfig(NamedTuple):
    """Parameters of the node ``controller``."""

    preset: Annotated[str, Spec("where the other defaults come from", choices=tuple(PRESETS), read_only=True)] = TUNED
    supervisor: SupervisorConfig = SupervisorConfig()
    pose_source: Annotated[
        str,
        Spec(
            "where the robot's pose comes from: the topic pose or the topic odometry/filtered",
            choices=("pose", "odometry"),
            read_only=True,
        ),
    ] = "pose"
    map_frame: Annotated[str, Spec("frame of poses and goals", read_only=True)] = "map"
    base_link_frame: Annotated[
        str, Spec("frame of the stamped command; child frame of odometry/filtered", read_only=True)
    ] = "base_link"
    enable_stamped_cmd_vel: Annotated[bool, Spec("publish TwistStamped instead of Twist", read_only=True)] = False


CONTROLLER_PRESETS = {
    name: ControllerNodeConfig(preset=name, supervisor=SupervisorConfig(controller=controller))
    for name, controller in PRESETS.items()
}
"""What the parameter ``preset`` chooses between."""
