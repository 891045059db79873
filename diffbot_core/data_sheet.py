"""The robot's data sheet: geometry, limits of the command, and what lies between command and motion."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import Spec

_INF = math.inf


class DataSheet(NamedTuple):
    """What every law knows of the robot. Names of the limits are those of diff_drive_controller; ``inf``: no limit."""

    wheels: WheelGeometry = WheelGeometry()
    v_max: Annotated[
        float,
        Spec("bound of |v|", "m/s", 0.0, exclusive_minimum=True, allow_inf=True, parameter="linear.x.max_velocity"),
    ] = 1.3
    omega_max: Annotated[
        float,
        Spec(
            "bound of |omega|", "rad/s", 0.0, exclusive_minimum=True, allow_inf=True, parameter="angular.z.max_velocity"
        ),
    ] = _INF
    wheel_max: Annotated[
        float,
        Spec(
            "bound of each wheel's |speed|",
            "rad/s",
            0.0,
            exclusive_minimum=True,
            allow_inf=True,
            parameter="wheel.max_velocity",
        ),
    ] = _INF
    a_max: Annotated[
        float,
        Spec(
            "bound of |dv/dt|",
            "m/s^2",
            0.0,
            exclusive_minimum=True,
            allow_inf=True,
            parameter="linear.x.max_acceleration",
        ),
    ] = _INF
    omega_dot_max: Annotated[
        float,
        Spec(
            "bound of |domega/dt|",
            "rad/s^2",
            0.0,
            exclusive_minimum=True,
            allow_inf=True,
            parameter="angular.z.max_acceleration",
        ),
    ] = _INF
    command_latency: Annotated[
        float, Spec("dead time from the command to the motion of the wheels", "s", minimum=0.0, maximum=5.0)
    ] = 0.0
    drive_time_constant: Annotated[float, Spec("first-order lag of the drives", "s", minimum=0.0, maximum=5.0)] = 0.0
    min_velocity: Annotated[float, Spec("smaller |v| moves nothing", "m/s", minimum=0.0, maximum=10.0)] = 0.0
    min_rotation: Annotated[float, Spec("smaller |omega| turns nothing", "rad/s", minimum=0.0, maximum=10.0)] = 0.0
