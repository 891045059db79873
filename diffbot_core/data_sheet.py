"""Data sheet of a robot: limits of its commands, and delays from a command to the motion."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple, TypeAlias

from diffbot_core.errors import InvalidValueError
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import ACCELERATION, ANGULAR_ACCELERATION, SPEED, TURN_RATE, WHEEL_SPEED, Spec, known_fields

_INF = math.inf
MAX_COMMAND_LATENCY = 5.0
"""[s]"""

MaxAcceleration: TypeAlias = Annotated[
    float, Spec("bound of |dv/dt|", "m/s^2", *ACCELERATION, allow_inf=True, parameter="linear.x.max_acceleration")
]
MaxAngularAcceleration: TypeAlias = Annotated[
    float,
    Spec(
        "bound of |domega/dt|",
        "rad/s^2",
        *ANGULAR_ACCELERATION,
        allow_inf=True,
        parameter="angular.z.max_acceleration",
    ),
]
CommandLatency: TypeAlias = Annotated[
    float,
    Spec(
        "dead time between a pose's stamp and the motion that its command causes",
        "s",
        0.0,
        MAX_COMMAND_LATENCY,
        parameter="command_latency",
    ),
]


@known_fields
class DataSheet(NamedTuple):
    """Limits and delays of a robot; ``inf`` means no limit. Parameters are named as in diff_drive_controller.

    The defaults are the velocities of the paper's robot at a rim speed of 1.3 m/s, which is a wheel speed of 26 rad/s.
    """

    v_max: Annotated[
        float,
        Spec("bound of |v|", "m/s", *SPEED, allow_inf=True, parameter="linear.x.max_velocity"),
    ] = 1.3
    omega_max: Annotated[
        float,
        Spec("bound of |omega|", "rad/s", *TURN_RATE, allow_inf=True, parameter="angular.z.max_velocity"),
    ] = 2.6
    wheel_max: Annotated[
        float,
        Spec("bound of each wheel's |speed|", "rad/s", *WHEEL_SPEED, allow_inf=True, parameter="wheel.max_velocity"),
    ] = 26.0
    a_max: MaxAcceleration = _INF
    omega_dot_max: MaxAngularAcceleration = _INF
    wheels: WheelGeometry = WheelGeometry()
    command_latency: CommandLatency = 0.0
    drive_time_constant: Annotated[
        float, Spec("time constant of the drives, which follow their command as a first-order lag", "s", 0.0, 5.0)
    ] = 0.0
    min_velocity: Annotated[float, Spec("smallest |v| that moves the robot (dead band)", "m/s", 0.0, 1.0)] = 0.0
    min_rotation: Annotated[float, Spec("smallest |omega| that turns the robot (dead band)", "rad/s", 0.0, 10.0)] = 0.0

    def check(self) -> None:
        """Raise InvalidValueError if a dead band exceeds its velocity limit: no command would move the robot."""
        pairs = (("min_velocity", self.min_velocity, self.v_max), ("min_rotation", self.min_rotation, self.omega_max))
        for name, dead_band, limit in pairs:
            if dead_band > limit:
                raise InvalidValueError(name, dead_band, f"<= {limit:g}, the largest velocity")


PAPER_DATA_SHEET = DataSheet(1.3, _INF, _INF, _INF, _INF)
"""The paper's robot, whose only limit is the bound of |v|."""


def rim_speed(data_sheet: DataSheet) -> float:
    """Return the bound [m/s] of |v| + |omega| L / 2, the speed of the faster wheel's rim."""
    return data_sheet.wheel_max * data_sheet.wheels.wheel_radius


def fastest(data_sheet: DataSheet) -> tuple[float, float]:
    """Return the largest speed [m/s] and the largest rate of a turn on the spot [rad/s]."""
    rim = rim_speed(data_sheet)
    return min(data_sheet.v_max, rim), min(data_sheet.omega_max, 2.0 * rim / data_sheet.wheels.wheel_separation)
