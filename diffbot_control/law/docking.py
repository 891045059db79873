"""Docking: to a staging pose on the dock's axis by the switching law, then along the axis until contact.

Poses and goals are in the dock's frame, see :mod:`docking_axis`. The goal at its origin is contact; one on the axis
before it undocks. On the way the predicted errors at contact decide whether the robot goes on, or drives out along the
axis and tries again.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.law.braking_step import braking_step
from diffbot_control.law.configuration import ControllerMemory, Report, new_memory
from diffbot_control.law.docking_axis import (
    Arrival,
    DockingConfig,
    along_axis,
    arrival,
    axis_lyapunov,
    fits,
    hold_heading,
    is_certain,
    is_inside,
    leading,
    pose_on_axis,
)
from diffbot_control.law.latency import Actuation, coast, is_immediate
from diffbot_control.law.limits import limit_change, limit_velocity
from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_control.law.regions import OMEGA_L
from diffbot_control.law.speed_profile import braking
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty

STAGING, APPROACHING, RETREATING, DOCKED, FAILED, UNDOCKING, UNDOCKED = 0, 1, 2, 3, 4, 5, 6
PHASE_NAMES = ("staging", "approaching", "retreating", "docked", "failed", "undocking", "undocked")

_ENTRY = 0.4
"""share of the tolerances that the predicted error may have where the approach begins"""
_REST = 1.0
"""[s] at the staging pose without an approach, after which the robot drives out along the axis to align"""
_STALL_TIME, _STALL_WAY, _STALL_STEP = 0.7, 0.01, 0.1
"""[s], [m] the robot counts as standing against the dock if it has come no farther in this time; [s] of it for one pose
at most"""
_MARGIN, _ALIGNING = 0.05, 0.5
"""[m] how far behind the staging pose a retreat ends: after an approach that was broken off, and from a rest beside the
axis"""
_LEAVE = 1.5
"""the corridor is left at this multiple of its bound: a noisy pose at its edge begins one approach, not many"""
_OUT_LENGTHS = 4.0
"""on the way out a lateral error decays more gently than towards the dock, in this multiple of lambda"""
_NEAR = 0.2
"""[m] the approach may begin so far before the staging pose"""
_WAITING = 0.01
"""[m] the robot counts as waiting so far before commit_distance, which it approaches ever more slowly"""
_BRAKE_SHARE = 0.5
"""share of the acceleration limit that the speed along the axis is planned with"""
_ON_AXIS, _ALONG_AXIS, _UNDOCKED = 0.01, 0.02, 0.02
"""[m] across, [rad], [m] along: what counts as on the axis, and as its end"""


class DockingMemory(NamedTuple):
    """What one step passes to the next."""

    phase: int
    tries: int
    """approaches broken off"""
    committed: bool
    """the robot goes on whether the dock is seen or not"""
    contact: bool
    """a switch or the charger reports that the robot touches the dock"""
    wait: float
    """[s] at rest at the staging pose, or until certain; without progress near contact"""
    nearest: float
    """[m] least distance so far near contact"""
    out: float
    """[m] distance from the dock at which a retreat ends"""
    command: Twist
    actuation: Actuation
    drive: ControllerMemory
    """of the law that drives to the staging pose"""
    reached: bool
    """docked"""


def new_docking_memory(config: DockingConfig) -> DockingMemory:
    """Return the memory at rest before the first pose."""
    drive = new_memory()
    return DockingMemory(
        phase=STAGING,
        tries=0,
        committed=False,
        contact=False,
        wait=0.0,
        nearest=math.inf,
        out=0.0,
        command=drive.command,
        actuation=drive.actuation,
        drive=drive,
        reached=False,
    )


def docking_step(
    memory: DockingMemory, estimate: Estimate, goal: Pose, dt: float, config: DockingConfig
) -> tuple[DockingMemory, Twist, Report]:
    """Drive towards contact, or out along the axis, for one period; as ``controller.step`` but for the frame.

    ``estimate`` and ``goal`` are in the dock's frame; a goal neither at its origin nor on the axis before it fails.
    At the goal, or after the last try, the command is zero.
    """
    sheet = config.drive.data_sheet
    if not math.isfinite(estimate.pose.x + estimate.pose.y + estimate.pose.theta):
        stopped = _with_motion(memory, Twist(0.0, 0.0), memory.actuation)
        return stopped, stopped.command, Report(math.nan, math.nan, math.nan, math.nan, 0.0, OMEGA_L, math.nan)
    actuation, rest = memory.actuation, estimate.pose
    if not is_immediate(sheet):
        coasted = coast(estimate.pose, memory.actuation, memory.command, dt, sheet)
        actuation, rest = coasted.actuation, coasted.pose
    pose, out = leading(rest, config), -leading(goal, config).x
    if memory.phase == STAGING and not _is_contact(goal):
        memory = _in_phase(memory, UNDOCKING if _is_undocked(goal, out) else FAILED, memory.tries)
    memory = _next_phase(memory, leading(estimate.pose, config), pose, estimate.uncertainty, out, dt, config)
    if memory.phase == STAGING:
        return _staging_step(memory, estimate, dt, config)
    requested = limit_velocity(_requested(memory, pose, out, config), sheet)
    if config.dock_backward:
        requested = Twist(-requested.v, requested.omega)
    command = limit_change(requested, memory.command, dt, sheet)
    if not math.isfinite(rest.x + rest.y + rest.theta + command.v + command.omega):
        command = Twist(0.0, 0.0)
    rho, alpha, beta = navigation_variables(into_frame(rest, goal))
    lyapunov = axis_lyapunov(pose, config.approach_length)
    report = Report(rho, alpha, beta, rest.theta, config.corridor, OMEGA_L, lyapunov)
    return _with_motion(memory, command, actuation), command, report


def reason_to_give_up(memory: DockingMemory, config: DockingConfig) -> str:
    """Return why the goal will not be reached; empty if it may."""
    if memory.phase != FAILED:
        return ""
    if memory.tries == 0:
        return "not at the dock nor on the axis before it"
    causes = "beside the axis, too uncertain at commit_distance, or a contact before the dock"
    return f"{memory.tries} approaches broken off: {causes}"


def describe(memory: DockingMemory) -> dict[str, str]:
    """Return what ~/status shows of the memory."""
    return {"phase": PHASE_NAMES[memory.phase], "approaches broken off": str(memory.tries)}


def _is_contact(goal: Pose) -> bool:
    return abs(goal.x) <= _UNDOCKED and abs(goal.y) <= _ON_AXIS and abs(goal.theta) <= _ALONG_AXIS


def _is_undocked(goal: Pose, out: float) -> bool:
    return out > _UNDOCKED and abs(goal.y) <= _ON_AXIS and abs(goal.theta) <= _ALONG_AXIS


def _next_phase(
    memory: DockingMemory,
    now: Pose,
    rest: Pose,
    uncertainty: Uncertainty,
    out: float,
    dt: float,
    config: DockingConfig,
) -> DockingMemory:
    """Decide from the pose that the robot has now, and from the one in which it would come to rest."""
    phase, distance = memory.phase, -rest.x
    if phase == STAGING:
        return _next_staging(memory, rest, dt, config)
    if phase == APPROACHING:
        return _next_approach(memory, now, rest, uncertainty, dt, config)
    if phase == RETREATING and distance >= memory.out - _UNDOCKED:
        return _in_phase(memory, FAILED if memory.tries >= config.dock_tries else STAGING, memory.tries)
    if phase == UNDOCKING and distance >= out - _UNDOCKED:
        return _in_phase(memory, UNDOCKED, memory.tries)
    return memory


def _next_staging(memory: DockingMemory, rest: Pose, dt: float, config: DockingConfig) -> DockingMemory:
    if memory.contact and abs(rest.x) <= config.straight_length and fits(Arrival(rest.y, rest.theta), 1.0, config):
        return _in_phase(memory, DOCKED, memory.tries)  # already docked
    near = config.straight_length < -rest.x <= config.staging_distance + _NEAR
    if near and is_inside(rest, 1.0, config) and fits(arrival(rest, config), _ENTRY, config):
        return _in_phase(memory, APPROACHING, memory.tries)
    standing = memory.drive.switching.region == OMEGA_L and memory.command.v == 0.0 and memory.command.omega == 0.0
    wait = memory.wait + dt if standing else 0.0
    if wait > _REST:
        # From there it comes back to the staging pose in motion, through the corridor.
        return _in_phase(memory, RETREATING, memory.tries, config.staging_distance + _ALIGNING)
    return _waiting(memory, False, wait, math.inf)


def _next_approach(
    memory: DockingMemory, now: Pose, rest: Pose, uncertainty: Uncertainty, dt: float, config: DockingConfig
) -> DockingMemory:
    if -now.x <= config.straight_length and (memory.committed or config.commit_distance <= config.straight_length):
        return _touching(memory, -now.x, dt, config)
    at, distance = arrival(rest, config), -rest.x
    inside = is_inside(rest, _LEAVE, config)
    # Whatever the robot touches there, it is not the dock, or the pose is wrong.
    goes_beside = memory.contact or not (inside and fits(at, 1.0, config))
    if (goes_beside and distance > config.straight_length) or memory.wait > config.commit_timeout:
        out = config.staging_distance + (_MARGIN if inside else _ALIGNING)
        return _in_phase(memory, RETREATING, memory.tries + 1, out)
    # Beyond this distance the robot can still stop at commit_distance.
    braking_way = config.dock_speed * (config.drive.profile_gains.react + 0.5 * config.dock_speed / _brake(config))
    if memory.committed or distance > config.commit_distance + braking_way:
        return memory
    committed = is_certain(at, distance, uncertainty, config)
    is_there = not committed and distance <= config.commit_distance + _WAITING
    return _waiting(memory, committed, memory.wait + dt if is_there else 0.0, math.inf)


def _touching(memory: DockingMemory, distance: float, dt: float, config: DockingConfig) -> DockingMemory:
    """Decide on the last way: the robot feels the dock, stands against it, or is beyond where it has to be."""
    # A gap between two poses does not mean that the robot stands.
    wait, nearest = memory.wait + min(dt, _STALL_STEP), memory.nearest
    if distance < nearest - _STALL_WAY:
        wait, nearest = 0.0, distance
    stands = wait > _STALL_TIME and distance <= config.press_distance
    if memory.contact or stands or distance <= -config.press_distance:
        return _in_phase(memory, DOCKED, memory.tries)
    return _waiting(memory, True, wait, nearest)


def _requested(memory: DockingMemory, pose: Pose, out: float, config: DockingConfig) -> Twist:
    """Return the command on the axis before the limits, of the end that leads."""
    phase, length, distance = memory.phase, config.approach_length, -pose.x
    if phase == RETREATING:
        return along_axis(pose, -_speed_to(memory.out + _MARGIN - distance, config), _OUT_LENGTHS * length)
    if phase == UNDOCKING:
        return along_axis(pose, -_speed_to(out - distance, config), _OUT_LENGTHS * length)
    if phase != APPROACHING:
        return Twist(0.0, 0.0)
    v = min(config.dock_speed, config.contact_speed + _speed_to(distance - config.straight_length, config))
    if not memory.committed:
        v = min(v, _speed_to(distance - config.commit_distance, config))
    if distance > config.commit_distance:
        return along_axis(pose, v, length)
    return hold_heading(pose, v, length) if distance > config.straight_length else Twist(v, 0.0)


def _speed_to(way: float, config: DockingConfig) -> float:
    """Return the speed [m/s] along the axis from which the robot can stop within ``way`` [m]."""
    if way <= 0.0:
        return 0.0
    speed = braking(way, _brake(config), config.drive.profile_gains.react)
    # Not less than what moves the robot at all, or it would stay where it is.
    return min(config.dock_speed, max(speed, config.drive.data_sheet.min_velocity))


def _brake(config: DockingConfig) -> float:
    """Return the deceleration [m/s^2] that the speed along the axis is planned with."""
    return min(config.drive.profile_gains.brake, _BRAKE_SHARE * config.drive.data_sheet.a_max)


def _staging_step(
    memory: DockingMemory, estimate: Estimate, dt: float, config: DockingConfig
) -> tuple[DockingMemory, Twist, Report]:
    """Drive to the staging pose by the switching law."""
    staging = pose_on_axis(config.staging_distance, config.dock_backward)
    # A new goal finds the motion in the memory alone, and a command may have been limited since the last step.
    before = _with_command(memory.drive, memory.command, memory.actuation)
    drive, command, report = braking_step(before, estimate, staging, dt, config.drive)
    after = DockingMemory(
        phase=STAGING,
        tries=memory.tries,
        committed=False,
        contact=memory.contact,
        wait=memory.wait,
        nearest=math.inf,
        out=0.0,
        command=command,
        actuation=drive.actuation,
        drive=drive,
        reached=False,
    )
    return after, command, report


def _with_command(drive: ControllerMemory, command: Twist, actuation: Actuation) -> ControllerMemory:
    # Compiled code has neither _replace nor defaults.
    return ControllerMemory(
        switching=drive.switching,
        command=command,
        settling=drive.settling,
        reapproach=drive.reapproach,
        finish=drive.finish,
        course=drive.course,
        actuation=actuation,
        reached=drive.reached,
    )


def _in_phase(memory: DockingMemory, phase: int, tries: int, out: float = 0.0) -> DockingMemory:
    """Begin a phase, with the motion that the robot has."""
    return DockingMemory(
        phase=phase,
        tries=tries,
        committed=False,
        contact=memory.contact,
        wait=0.0,
        nearest=math.inf,
        out=out,
        command=memory.command,
        actuation=memory.actuation,
        drive=_with_command(new_memory(), memory.command, memory.actuation),
        reached=phase in (DOCKED, UNDOCKED),
    )


def _waiting(memory: DockingMemory, committed: bool, wait: float, nearest: float) -> DockingMemory:
    return DockingMemory(
        phase=memory.phase,
        tries=memory.tries,
        committed=committed,
        contact=memory.contact,
        wait=wait,
        nearest=nearest,
        out=memory.out,
        command=memory.command,
        actuation=memory.actuation,
        drive=memory.drive,
        reached=memory.reached,
    )


def _with_motion(memory: DockingMemory, command: Twist, actuation: Actuation) -> DockingMemory:
    return DockingMemory(
        phase=memory.phase,
        tries=memory.tries,
        committed=memory.committed,
        contact=memory.contact,
        wait=memory.wait,
        nearest=memory.nearest,
        out=memory.out,
        command=command,
        actuation=actuation,
        drive=memory.drive,
        reached=memory.reached,
    )


class Docking:
    """Docking in the form of :class:`diffbot_control.goals.protocol.Law`."""

    name = "docking"
    Config = DockingConfig
    new_memory = staticmethod(new_docking_memory)
    step = staticmethod(docking_step)
    reason_to_give_up = staticmethod(reason_to_give_up)
    describe = staticmethod(describe)
