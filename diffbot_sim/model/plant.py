"""The true motion of the robot: drives, noise, kinematics, encoders. Pure functions of floats.

A command reaches the wheels through :mod:`actuators` and a drive that does not hold its speed exactly; the body moves
with the true wheels; the encoders measure the true wheel angles with an error. The paper's input noise (Eqs. (6), (7))
comes in two forms that may be combined: added to v and omega (``eps_v_max``, ``eps_omega_max``, section 4.1), and as
its cause, a relative error of each wheel's speed (``drive_noise``).
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist, WheelGeometry, WheelSpeeds, body_twist, wheel_speeds
from diffbot_core.ranges import POSITION, TIME, TIMEOUT
from diffbot_core.schema import Spec, known_fields
from diffbot_sim.model.actuators import (
    NO_LOSS,
    ActuatorConfig,
    ActuatorState,
    LostShares,
    actuate,
    lost_shares,
    new_actuators,
)
from diffbot_sim.model.philox import SLIP_BLOCK, WHEEL_BLOCK, Draw, NoiseKey, draw

_ADDED = 0.0, 1e3
"""[m/s], [rad/s] noise added to the twist"""
_STRAIGHT = 1e-6
"""[rad] turns below it are integrated by their series: the quotient of the arc loses digits there."""


@known_fields
class PlantConfig(NamedTuple):
    """The robot and its faults; the defaults are the paper's robot with +-5 % per wheel in drive and encoder."""

    wheels: WheelGeometry = WheelGeometry()
    sampling_time: Annotated[float, Spec("Ts", "s", minimum=1e-3, maximum=10.0, read_only=True)] = 0.1
    exact_arc: Annotated[bool, Spec("integrate along the exact arc; otherwise by Euler, Eq. (3) as printed")] = True
    drive_noise: Annotated[
        float, Spec("bound of the relative error of each wheel's speed", minimum=0.0, maximum=1.0)
    ] = 0.05
    eps_v_max: Annotated[float, Spec("bound of the noise added to v (paper: 0.065)", "m/s", *_ADDED)] = 0.0
    eps_omega_max: Annotated[float, Spec("bound of the noise added to omega (paper: 0.2167)", "rad/s", *_ADDED)] = 0.0
    encoder_noise: Annotated[
        float, Spec("bound of the relative error of each encoder's speed", minimum=0.0, maximum=1.0)
    ] = 0.05
    left_radius_error: Annotated[
        float, Spec("relative error of the left wheel's radius", minimum=-0.5, maximum=0.5)
    ] = 0.0
    right_radius_error: Annotated[
        float, Spec("relative error of the right wheel's radius", minimum=-0.5, maximum=0.5)
    ] = 0.0
    slip_left: Annotated[
        float,
        Spec("share of the left wheel's motion lost while it slips", minimum=0.0, maximum=1.0),
    ] = 0.0
    slip_right: Annotated[
        float,
        Spec("share of the right wheel's motion lost while it slips", minimum=0.0, maximum=1.0),
    ] = 0.0
    slip_start: Annotated[float, Spec("time at which the slip begins", "s", *TIME)] = 0.0
    slip_duration: Annotated[float, Spec("duration of the slip", "s", *TIME)] = 0.0
    kidnap_time: Annotated[float, Spec("time at which the robot is carried away; 0: never", "s", *TIME)] = 0.0
    kidnap_x: Annotated[float, Spec("how far the robot is carried along x of map", "m", *POSITION)] = 0.0
    kidnap_y: Annotated[float, Spec("how far the robot is carried along y of map", "m", *POSITION)] = 0.0
    kidnap_yaw: Annotated[
        float, Spec("how far the robot is turned when it is carried away", "rad", minimum=-math.pi, maximum=math.pi)
    ] = 0.0
    actuators: ActuatorConfig = ActuatorConfig()
    cmd_vel_timeout: Annotated[float, Spec("without a command for so long the robot stops", "s", *TIMEOUT)] = 0.5


class PlantState(NamedTuple):
    """Truth and encoders after a number of steps."""

    pose: Pose
    """true pose in ``map``"""
    twist: Twist = Twist(0.0, 0.0)
    """true mean twist over the last step"""
    actuators: ActuatorState = ActuatorState()
    """what they remember of the last step"""
    encoder: WheelSpeeds = WheelSpeeds(0.0, 0.0)
    """[rad/s] mean speeds over the last step as the encoders measured them"""
    angles: WheelSpeeds = WheelSpeeds(0.0, 0.0)
    """[rad] wheel angles counted by the encoders"""
    odometry: Pose = Pose(0.0, 0.0, 0.0)
    """pose in ``odom``, integrated from the encoders"""
    step: int = 0
    """number of steps taken"""


def new_plant(pose: Pose) -> PlantState:
    """Return the robot at rest at ``pose`` in map, before step 0."""
    rest = WheelSpeeds(0.0, 0.0)
    return PlantState(pose, Twist(0.0, 0.0), new_actuators(), rest, rest, Pose(0.0, 0.0, 0.0), 0)


def plant_step_at(key: NoiseKey, state: PlantState, command: Twist, config: PlantConfig) -> PlantState:
    """Move the robot for one sampling time with the noise of this step; see :func:`plant_step`."""
    noise, scale = draw(key.seed, key.run, key.step, WHEEL_BLOCK), config.actuators.slip_noise
    lost = NO_LOSS
    if scale > 0.0:
        lost = lost_shares(draw(key.seed, key.run, key.step, SLIP_BLOCK), scale)
    return plant_step(state, command, noise, config, lost)


def plant_step(
    state: PlantState, command: Twist, noise: Draw, config: PlantConfig, lost: LostShares = NO_LOSS
) -> PlantState:
    """Move the robot for one sampling time.

    Args:
        state: before the step.
        command: requested twist, held over the step; after the dead time, see :func:`actuators.delayed_command`.
        noise: (left drive or v, right drive or omega, left encoder, right encoder), uniform in (-1, 1).
        config: robot, noise bounds and faults.
        lost: shares of the wheels' motion that slip takes in this step.
    """
    t_s = config.sampling_time
    actuators = actuate(state.actuators, command, config.wheels, t_s, config.actuators)
    turned = WheelSpeeds(
        actuators.turning.left * (1.0 + config.drive_noise * noise.a),
        actuators.turning.right * (1.0 + config.drive_noise * noise.b),
    )
    rolled = _rolled(turned, lost, state.step, config)
    ideal = body_twist(rolled, _true_wheels(config))
    eps_v, eps_omega = config.eps_v_max * noise.a, config.eps_omega_max * noise.b
    twist = Twist(ideal.v + eps_v, ideal.omega + eps_omega)
    # The added noise turns the wheels, so the encoders measure it too.
    added = wheel_speeds(Twist(eps_v, eps_omega), config.wheels)
    encoder = WheelSpeeds(
        (turned.left + added.left) * (1.0 + config.encoder_noise * noise.c),
        (turned.right + added.right) * (1.0 + config.encoder_noise * noise.d),
    )
    angles = WheelSpeeds(state.angles.left + encoder.left * t_s, state.angles.right + encoder.right * t_s)
    return PlantState(
        _kidnapped(integrate(state.pose, twist, t_s, config.exact_arc), state.step, config),
        twist,
        actuators,
        encoder,
        angles,
        integrate(state.odometry, body_twist(encoder, config.wheels), t_s, True),
        state.step + 1,
    )


def integrate(pose: Pose, twist: Twist, t_s: float, exact_arc: bool) -> Pose:
    """Move ``pose`` by a constant ``twist`` for ``t_s`` [s]: along the arc, Eq. (1), or by one Euler step, Eq. (3)."""
    x, y, theta = pose
    forward = twist.v * t_s
    turn = twist.omega * t_s
    if not exact_arc:
        return Pose(x + forward * math.cos(theta), y + forward * math.sin(theta), wrap_angle(theta + turn))
    # Chord of the arc: length forward * sin(turn/2) / (turn/2), direction theta + turn/2.
    half = 0.5 * turn
    chord = forward * (1.0 - half * half / 6.0 if abs(half) < _STRAIGHT else math.sin(half) / half)
    return Pose(
        x + chord * math.cos(theta + half),
        y + chord * math.sin(theta + half),
        wrap_angle(theta + turn),
    )


def _true_wheels(config: PlantConfig) -> WheelGeometry:
    """Return the nominal wheels at their true distance."""
    wheels = config.wheels
    return WheelGeometry(wheels.wheel_radius, wheels.wheel_separation * (1.0 + config.actuators.separation_error))


def _kidnapped(pose: Pose, step: int, config: PlantConfig) -> Pose:
    """Return the pose, displaced if the robot is kidnapped in this step, the one that ends at ``kidnap_time``."""
    if config.kidnap_time <= 0.0 or step + 1 != max(math.ceil(config.kidnap_time / config.sampling_time - 1e-9), 1):
        return pose
    x, y, theta = pose
    return Pose(x + config.kidnap_x, y + config.kidnap_y, wrap_angle(theta + config.kidnap_yaw))


def _rolled(turned: WheelSpeeds, lost: LostShares, step: int, config: PlantConfig) -> WheelSpeeds:
    """Return the speeds of nominal wheels that move the robot as the true ones do, with radius errors and slip."""
    left = turned.left * (1.0 + config.left_radius_error) * (1.0 - lost.left)
    right = turned.right * (1.0 + config.right_radius_error) * (1.0 - lost.right)
    # In steps, with a margin for rounding: 1.1 s and 3.2 s make 43 steps of 0.1 s.
    begin = config.slip_start / config.sampling_time - 1e-9
    end = (config.slip_start + config.slip_duration) / config.sampling_time - 1e-9
    if begin <= step < end:
        left *= 1.0 - config.slip_left
        right *= 1.0 - config.slip_right
    return WheelSpeeds(left, right)
