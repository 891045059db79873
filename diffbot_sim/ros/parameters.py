"""Parameters of the node ``plant``."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.ros.frames import PREFIX_TEXT
from diffbot_core.data_sheet import CommandLatency, MaxAcceleration, MaxAngularAcceleration
from diffbot_core.errors import InvalidValueError
from diffbot_core.ranges import TIMEOUT
from diffbot_core.ros.command_parameters import CommandSourceConfig
from diffbot_core.ros.fault_parameters import FaultConfig
from diffbot_core.schema import Spec
from diffbot_sim.model.simulator import WorldConfig
from diffbot_sim.ros.pacing import CLOCKS, LOCKSTEP, SCALED, WALL


class SharedSheet(NamedTuple):
    """What the plant reads of the controller's data sheet: a file for both then has it once, in its section ``/**``.

    The smaller bound acts, of it and of the actuators, and the larger dead time.
    """

    a_max: MaxAcceleration = math.inf
    omega_dot_max: MaxAngularAcceleration = math.inf
    command_latency: CommandLatency = 0.0


class PlantNodeConfig(NamedTuple):
    """Parameters of the node ``plant``."""

    world: WorldConfig = WorldConfig()
    """without the shared data sheet, see :meth:`simulated`"""
    sheet: SharedSheet = SharedSheet()
    clock: Annotated[
        str,
        Spec(
            "who sets the pace: real time, real time times a factor, or the controller",
            choices=CLOCKS,
            read_only=True,
        ),
    ] = WALL
    real_time_factor: Annotated[
        float,
        Spec(
            "simulated over real time, for clock: scaled",
            minimum=0.001,
            maximum=1000.0,
            read_only=True,
        ),
    ] = 1.0
    publish_clock: Annotated[
        bool,
        Spec("publish /clock, for clock: scaled; false: take the steps by the /clock of another plant", read_only=True),
    ] = True
    start_time: Annotated[
        float,
        Spec(
            "time of the first step; 0: now",
            "s since 1970",
            minimum=0.0,
            maximum=2e9,
            read_only=True,
        ),
    ] = 0.0
    start_paused: Annotated[bool, Spec("wait for ~/pause with data: false", read_only=True)] = False
    lockstep_timeout: Annotated[
        float,
        Spec(
            "without an answer for so long a step's messages are sent again (clock: lockstep)",
            "s",
            minimum=0.01,
            maximum=TIMEOUT[1],
        ),
    ] = 1.0
    enable_stamped_cmd_vel: Annotated[bool, Spec("subscribe to TwistStamped instead of Twist", read_only=True)] = False
    left_wheel_name: Annotated[str, Spec("joint of the left wheel", read_only=True)] = "left_wheel_joint"
    right_wheel_name: Annotated[str, Spec("joint of the right wheel", read_only=True)] = "right_wheel_joint"
    map_frame: Annotated[str, Spec("frame of fixes and truth", read_only=True)] = "map"
    odom_frame: Annotated[str, Spec("frame of the odometry", read_only=True)] = "odom"
    base_link_frame: Annotated[str, Spec("frame of the robot", read_only=True)] = "base_link"
    frame_prefix: Annotated[str, Spec(PREFIX_TEXT, read_only=True)] = ""
    publish_tf: Annotated[bool, Spec("publish odom -> base_link", read_only=True)] = True
    commands: CommandSourceConfig = CommandSourceConfig()
    faults: FaultConfig = FaultConfig()

    def simulated(self) -> WorldConfig:
        """Return the world with the shared data sheet in it."""
        plant, sheet = self.world.plant, self.sheet
        actuators = plant.actuators._replace(
            acceleration_max=min(plant.actuators.acceleration_max, sheet.a_max),
            angular_acceleration_max=min(plant.actuators.angular_acceleration_max, sheet.omega_dot_max),
            command_delay=max(plant.actuators.command_delay, sheet.command_latency),
        )
        return self.world._replace(plant=plant._replace(actuators=actuators))

    def owns_time(self) -> bool:
        """Return True if the plant publishes /clock."""
        return self.clock != WALL and self.publish_clock

    def follows_time(self) -> bool:
        """Return True if the plant takes its steps by the /clock of another one."""
        return self.clock == SCALED and not self.publish_clock

    def check(self) -> None:
        """Refuse lock-step without a clock.

        Raises:
            InvalidValueError: since no node could follow.
        """
        if self.clock == LOCKSTEP and not self.publish_clock:
            raise InvalidValueError("publish_clock", self.publish_clock, "true with clock = 'lockstep'")
