"""Parameters of the node ``plant``."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.endpoints import AUTO, TYPE_WORDS
from diffbot_core.schema import Spec
from diffbot_core.shared_parameters import PREFIX_TEXT, CommandSourceConfig, FaultConfig
from diffbot_sim.config import WorldConfig

WALL, SCALED, LOCKSTEP = "wall", "scaled", "lockstep"
CLOCKS = (WALL, SCALED, LOCKSTEP)


class PlantNodeConfig(NamedTuple):
    """Parameters of the node ``plant``."""

    world: WorldConfig = WorldConfig()
    clock: Annotated[
        str,
        Spec(
            "pace of the simulation: real time, real time times a factor, or one step per answer of the controller",
            choices=CLOCKS,
            read_only=True,
        ),
    ] = WALL
    real_time_factor: Annotated[
        float,
        Spec("simulated time per real time, with clock: scaled", minimum=0.001, maximum=1000.0, read_only=True),
    ] = 1.0
    start_time: Annotated[
        float, Spec("time of the first step; 0: now", "s since 1970", minimum=0.0, maximum=2e9, read_only=True)
    ] = 0.0
    start_paused: Annotated[bool, Spec("start paused, until ~/pause is called with data: false", read_only=True)] = (
        False
    )
    cmd_vel_type: Annotated[
        str,
        Spec(
            "type of the commands; auto: TwistStamped with clock: lockstep, else Twist",
            choices=(AUTO, *TYPE_WORDS.values()),
            read_only=True,
        ),
    ] = AUTO
    left_wheel_name: Annotated[str, Spec("joint of the left wheel", read_only=True)] = "left_wheel_joint"
    right_wheel_name: Annotated[str, Spec("joint of the right wheel", read_only=True)] = "right_wheel_joint"
    map_frame: Annotated[str, Spec("frame of the fixes and of the true pose", read_only=True)] = "map"
    odom_frame: Annotated[str, Spec("frame of the odometry", read_only=True)] = "odom"
    base_link_frame: Annotated[str, Spec("frame of the robot", read_only=True)] = "base_link"
    frame_prefix: Annotated[str, Spec(PREFIX_TEXT, read_only=True)] = ""
    publish_tf: Annotated[bool, Spec("publish the transform odom -> base_link", read_only=True)] = True
    commands: CommandSourceConfig = CommandSourceConfig()
    faults: FaultConfig = FaultConfig()
