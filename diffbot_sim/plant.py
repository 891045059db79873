"""True motion of the robot: drives, noise, kinematics, encoders. Pure functions of floats.

A command passes these stages in this order. Each stage is off by default and then does not change the command:

1. dead time of the link and the base driver (:func:`delayed_command`),
2. acceleration limits of the base driver, separately for v and omega, once in each sampling time,
3. saturation of the wheels, which keeps the curvature,
4. first-order lag of each wheel, tau dw/dt = u - w, solved exactly for a target u that is constant over the step,
5. dead band: a wheel stands still if its drive turns more slowly than ``dead_band``.

The wheels do not turn exactly at the speed of their drives. The true radii and separation of the wheels may differ from
the configured values. A slipping wheel moves the robot less than its encoder measures. The encoders measure the true
wheel angles with an error.

The paper's input noise (Eqs. (6), (7)) has two forms, which can be combined: noise added to v and omega (``eps_v_max``,
``eps_omega_max``, section 4.1), and a relative error of each wheel's speed (``drive_noise``).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_core.geometry import Pose, into_frame, wrap_angle
from diffbot_core.kinematics import Twist, WheelGeometry, WheelSpeeds, body_twist, wheel_speeds
from diffbot_sim.config import DetectorConfig, PlantConfig, dock_pose
from diffbot_sim.noise import FURTHER, MOTION, half_normal, uniform

_STRAIGHT = 1e-6
"""[rad] half turn below which sin(x) / x is replaced by its series, since the quotient is undefined at 0"""
DOCK_HALF_WIDTH = 0.2
"""[m] half of the width of the dock, and also the depth of the dock"""


class DriveState(NamedTuple):
    """State of the drives after a step."""

    limited: Twist = Twist(0.0, 0.0)
    """command after the acceleration limits"""
    lagged: WheelSpeeds = WheelSpeeds(0.0, 0.0)
    """[rad/s] speeds of the drives at the end of the step, before the dead band"""
    turning: WheelSpeeds = WheelSpeeds(0.0, 0.0)
    """[rad/s] mean speeds over the step, after the dead band"""


class PlantState(NamedTuple):
    """True state and encoders after a number of steps."""

    pose: Pose
    """true pose in ``map``"""
    twist: Twist = Twist(0.0, 0.0)
    """true mean twist over the last step"""
    drives: DriveState = DriveState()
    encoder: WheelSpeeds = WheelSpeeds(0.0, 0.0)
    """[rad/s] measured mean speeds over the last step"""
    angles: WheelSpeeds = WheelSpeeds(0.0, 0.0)
    """[rad] measured wheel angles"""
    odometry: Pose = Pose(0.0, 0.0, 0.0)
    """pose in ``odom``, integrated from the encoders"""
    step: int = 0
    """number of completed steps"""


def new_plant(pose: Pose) -> PlantState:
    """Return the state of a robot at rest at ``pose`` in map, before step 0."""
    rest, still = WheelSpeeds(0.0, 0.0), Twist(0.0, 0.0)
    return PlantState(pose, still, DriveState(still, rest, rest), rest, rest, Pose(0.0, 0.0, 0.0), 0)


def plant_step(state: PlantState, command: Twist, noise: Any, config: PlantConfig) -> PlantState:
    """Move the robot for one sampling time.

    Args:
        state: state before the step.
        command: twist that arrives at the base driver in this step, see :func:`delayed_command`.
        noise: (purposes, 4) numbers in [0, 1) of this step, see :mod:`noise`.
        config: robot, noise bounds and faults.
    """
    t_s = config.sampling_time
    drives = _drives_step(state.drives, command, config)
    turned = WheelSpeeds(
        drives.turning.left * (1.0 + uniform(noise[MOTION, 0], config.drive_noise)),
        drives.turning.right * (1.0 + uniform(noise[MOTION, 1], config.drive_noise)),
    )
    wheels = config.wheels
    true_wheels = WheelGeometry(wheels.wheel_radius, wheels.wheel_separation * (1.0 + config.separation_error))
    ideal = body_twist(_effective_speeds(turned, noise, state.step, config), true_wheels)
    added = Twist(uniform(noise[MOTION, 0], config.eps_v_max), uniform(noise[MOTION, 1], config.eps_omega_max))
    twist = Twist(ideal.v + added.v, ideal.omega + added.omega)
    # The added noise turns the wheels, so the encoders measure it too.
    more = wheel_speeds(added, wheels)
    encoder = WheelSpeeds(
        (turned.left + more.left) * (1.0 + uniform(noise[MOTION, 2], config.encoder_noise)),
        (turned.right + more.right) * (1.0 + uniform(noise[MOTION, 3], config.encoder_noise)),
    )
    return PlantState(
        _kidnapped(integrate(state.pose, twist, t_s, config.exact_arc), state.step, config),
        twist,
        drives,
        encoder,
        WheelSpeeds(state.angles.left + encoder.left * t_s, state.angles.right + encoder.right * t_s),
        integrate(state.odometry, body_twist(encoder, wheels), t_s, True),
        state.step + 1,
    )


def integrate(pose: Pose, twist: Twist, t_s: float, exact_arc: bool) -> Pose:
    """Move ``pose`` by a constant ``twist`` for ``t_s`` [s]: along the arc, Eq. (1), or by one Euler step, Eq. (3)."""
    x, y, theta = pose
    forward, turn = twist.v * t_s, twist.omega * t_s
    if not exact_arc:
        return Pose(x + forward * math.cos(theta), y + forward * math.sin(theta), wrap_angle(theta + turn))
    # Chord of the arc: length forward * sin(turn/2) / (turn/2), direction theta + turn/2.
    half = 0.5 * turn
    chord = forward * (1.0 - half * half / 6.0 if abs(half) < _STRAIGHT else math.sin(half) / half)
    return Pose(x + chord * math.cos(theta + half), y + chord * math.sin(theta + half), wrap_angle(theta + turn))


def command_rows(delay: float, sampling_time: float) -> int:
    """Return the number of commands that :func:`delayed_command` has to store for a delay [s]; 0 without a delay."""
    return math.ceil(delay / sampling_time) + 2 if delay > 0.0 else 0


def delayed_command(record: Any, step: int, command: Twist, delay: float, sampling_time: float) -> Twist:
    """Store a command and return the mean command over this step after a dead time.

    If the delay is not a whole number of steps, two commands act during the step. The result is their mean, weighted by
    their shares of the step. Before step 0 the command is zero.

    Args:
        record: (n, 2) ring buffer of the newest commands, initially zero; n = 0 or at least :func:`command_rows`.
        step: number of the present step.
        command: requested in the present step.
        delay: dead time [s].
        sampling_time: [s].
    """
    rows = len(record)
    if rows == 0:
        return command
    record[step % rows, 0], record[step % rows, 1] = command.v, command.omega
    late = delay / sampling_time
    # The margin absorbs rounding errors: 0.3 / 0.1 is slightly less than 3.
    whole = math.floor(late + 1e-9)
    newer, older = (step - whole) % rows, (step - whole - 1) % rows
    share = late - whole
    if share < 1e-9:
        return Twist(float(record[newer, 0]), float(record[newer, 1]))
    return Twist(
        float(share * record[older, 0] + (1.0 - share) * record[newer, 0]),
        float(share * record[older, 1] + (1.0 - share) * record[newer, 1]),
    )


def touches_dock(pose: Pose, config: DetectorConfig) -> bool:
    """Return True if a robot at ``pose`` in map touches its dock."""
    lateral = into_frame(pose, dock_pose(config)).y
    return 0.0 <= _depth_at_dock(pose, config) <= DOCK_HALF_WIDTH and abs(lateral) <= DOCK_HALF_WIDTH


def stopped_by_dock(before: PlantState, after: PlantState, config: DetectorConfig) -> PlantState:
    """Return the state after a step that began in contact with the dock.

    If the robot would move further into the dock, the dock stops it, and the wheels stall.
    """
    if _depth_at_dock(after.pose, config) <= _depth_at_dock(before.pose, config):
        return after
    rest = WheelSpeeds(0.0, 0.0)
    return after._replace(
        pose=before.pose, twist=Twist(0.0, 0.0), encoder=rest, angles=before.angles, odometry=before.odometry
    )


def _depth_at_dock(pose: Pose, config: DetectorConfig) -> float:
    """Return the distance [m] by which a robot at ``pose`` in map is beyond the pose of the docked robot."""
    x = into_frame(pose, dock_pose(config)).x
    return -x if config.detection_behind else x


def _drives_step(state: DriveState, command: Twist, config: PlantConfig) -> DriveState:
    """Return the state of the drives after one sampling time under a command that has arrived at the base driver."""
    t_s, tau = config.sampling_time, config.drive_time_constant
    limited = Twist(
        _limit_change(state.limited.v, command.v, config.acceleration_max * t_s),
        _limit_change(state.limited.omega, command.omega, config.angular_acceleration_max * t_s),
    )
    requested = wheel_speeds(limited, config.wheels)
    fastest = max(abs(requested.left), abs(requested.right))
    scale = config.wheel_speed_max / fastest if fastest > config.wheel_speed_max else 1.0
    drive = WheelSpeeds(requested.left * scale, requested.right * scale)
    lagged, mean = drive, drive
    if tau > 0.0:
        left, right = state.lagged.left - drive.left, state.lagged.right - drive.right
        # Remaining share of the difference: at the end of the step, and in the mean over the step.
        end, share = math.exp(-t_s / tau), -math.expm1(-t_s / tau) / (t_s / tau)
        lagged = WheelSpeeds(drive.left + left * end, drive.right + right * end)
        mean = WheelSpeeds(drive.left + left * share, drive.right + right * share)
    turning = WheelSpeeds(_apply_dead_band(mean.left, config.dead_band), _apply_dead_band(mean.right, config.dead_band))
    return DriveState(limited, lagged, turning)


def _limit_change(before: float, requested: float, change: float) -> float:
    """Return ``requested``, limited to +-``change`` around ``before``."""
    return min(max(requested, before - change), before + change)


def _apply_dead_band(speed: float, dead_band: float) -> float:
    """Return the speed of a wheel whose drive turns at ``speed`` [rad/s]."""
    return 0.0 if abs(speed) < dead_band else speed


def _effective_speeds(turned: WheelSpeeds, noise: Any, step: int, config: PlantConfig) -> WheelSpeeds:
    """Return the speeds at which wheels without radius errors and slip would move the robot in the same way."""
    left, right = turned.left * (1.0 + config.left_radius_error), turned.right * (1.0 + config.right_radius_error)
    if config.slip_noise > 0.0:
        lost_left, lost_right = half_normal(noise[FURTHER, 2], noise[FURTHER, 3], config.slip_noise)
        left, right = left * (1.0 - min(lost_left, 1.0)), right * (1.0 - min(lost_right, 1.0))
    # In steps. The margin absorbs rounding errors: (1.1 + 3.2) / 0.1 is slightly more than 43.
    begin = config.slip_start / config.sampling_time - 1e-9
    end = (config.slip_start + config.slip_duration) / config.sampling_time - 1e-9
    if begin <= step < end:
        right *= 1.0 - config.slip_right
    return WheelSpeeds(left, right)


def _kidnapped(pose: Pose, step: int, config: PlantConfig) -> Pose:
    """Return the pose, displaced if the robot is kidnapped at the end of this step."""
    if config.kidnap_time <= 0.0 or step + 1 != max(math.ceil(config.kidnap_time / config.sampling_time - 1e-9), 1):
        return pose
    x, y, theta = pose
    return Pose(x + config.kidnap_x, y, wrap_angle(theta + config.kidnap_yaw))
