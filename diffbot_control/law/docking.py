"""The law ``docking``: drive to a staging pose with the law ``switching``, then along the dock's axis until contact.

Poses and goals are in the dock's frame, see :mod:`docking_axis`. For a goal at the origin the robot docks; for a goal
on the axis before the origin it undocks. During the approach, the predicted errors at contact decide whether the robot
continues, or retreats along the axis and tries again.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.law.configuration import DockingConfig
from diffbot_control.law.docking_axis import (
    APPROACH_LENGTH,
    CORRIDOR,
    STRAIGHT_LENGTH,
    ContactError,
    along_axis,
    axis_lyapunov,
    contact_error,
    forward_pose,
    hold_heading,
    is_certain,
    is_inside,
    is_within,
    pose_on_axis,
)
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.latency import Actuation, after_a_period, coast, is_immediate, resting_actuation
from diffbot_control.law.law import CONTACT, CONTACT_UNKNOWN, Law, Observation, Report
from diffbot_control.law.limits import limit_change, limit_velocity
from diffbot_control.law.regions import OMEGA_L
from diffbot_control.law.steering import Gains, braking, gains_of, navigation_variables
from diffbot_control.law.switching import SwitchingMemory, new_memory, with_motion
from diffbot_control.law.switching import step as switching_step
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Uncertainty

STAGING, APPROACHING, RETREATING, DOCKED, FAILED, UNDOCKING, UNDOCKED = 0, 1, 2, 3, 4, 5, 6
PHASE_NAMES = ("staging", "approaching", "retreating", "docked", "failed", "undocking", "undocked")

_ENTRY = 0.4
"""largest predicted error at contact with which the approach begins, as a share of the tolerances"""
_REST = 1.0
"""[s] time at rest at the staging pose after which the robot retreats along the axis to align itself"""
_STALL_TIME, _STALL_DISTANCE, _STALL_STEP = 0.7, 0.01, 0.1
"""The robot stands against the dock if it moves less than _STALL_DISTANCE [m] towards it in _STALL_TIME [s]. The time
between two poses counts as at most _STALL_STEP [s]."""
_MARGIN, _ALIGNING = 0.05, 0.5
"""[m] distance behind the staging pose at which a retreat ends: after an approach that was broken off in the corridor,
and after a rest at the staging pose or an approach that was broken off outside the corridor"""
_COMMIT_TIMEOUT = 4.0
"""[s] longest time that the robot waits at commit_distance for a certain estimate, and at the dock for contact"""
_LEAVE = 1.5
"""bound of the corridor during an approach, as a multiple of CORRIDOR: a hysteresis against noisy poses"""
_RETREAT_LENGTHS = 4.0
"""length over which a lateral error decays during a retreat, as a multiple of lambda"""
_NEAR = 0.2
"""[m] largest distance behind the staging pose at which an approach may begin"""
_WAITING = 0.01
"""[m] distance before commit_distance from which on the robot counts as waiting"""
_BRAKE_SHARE = 0.5
"""share of the acceleration limit that the speed along the axis uses"""
_ON_AXIS, _ALONG_AXIS, _UNDOCKED = 0.01, 0.02, 0.02
"""[m] lateral, [rad], [m] along the axis: tolerances of a goal on the axis, and of the end of a drive along it"""


class Stage(NamedTuple):
    """Phase of the docking, with its counters."""

    phase: int
    tries: int
    """number of approaches that were broken off"""
    committed: bool
    """the robot drives on to the dock, even if the estimate becomes uncertain"""
    wait: float
    """[s] time at rest at the staging pose, time of waiting for certainty, or time without progress near contact"""
    nearest: float
    """[m] smallest distance from contact so far"""
    retreat: float
    """[m] distance from the dock at which a retreat ends"""


class DockingMemory(NamedTuple):
    """State of the law between two steps."""

    stage: Stage
    command: Twist
    actuation: Actuation
    drive: SwitchingMemory
    """memory of the law ``switching``, which drives to the staging pose"""
    reached: bool
    """the robot is docked, or undocked"""


class StageInput(NamedTuple):
    """Input for the next stage. Poses are in the dock's frame, as :func:`forward_pose` returns them."""

    now: Pose
    """estimated pose"""
    rest: Pose
    """pose in which the robot would come to rest"""
    uncertainty: Uncertainty
    contact: int
    dt: float
    stands: bool
    """the robot rests at the staging pose"""
    goal_distance: float
    """[m] distance of the goal from the dock"""
    gains: Gains


def _begin(phase: int, tries: int, retreat: float = 0.0) -> Stage:
    return Stage(phase, tries, False, 0.0, math.inf, retreat)


def new_docking_memory(config: DockingConfig) -> DockingMemory:
    """Return the memory at rest before the first pose."""
    return DockingMemory(_begin(STAGING, 0), Twist(0.0, 0.0), resting_actuation(), new_memory(), False)


def docking_step(
    memory: DockingMemory, observation: Observation, goal: Pose, config: DockingConfig
) -> tuple[DockingMemory, Twist, Report]:
    """Dock or undock for one period; see :meth:`Law.step`.

    Pose and goal are in the dock's frame. The robot gives up a goal that is neither at the origin nor on the axis
    before the origin. The command is zero at the goal and after the last approach.
    """
    sheet, estimate, dt = config.drive.data_sheet, observation.estimate, observation.dt
    if not math.isfinite(estimate.pose.x + estimate.pose.y + estimate.pose.theta):
        stop = Twist(0.0, 0.0)
        stopped = DockingMemory(memory.stage, stop, memory.actuation, memory.drive, memory.reached)
        return stopped, stop, Report(math.nan, math.nan, math.nan, math.nan, 0.0, OMEGA_L, math.nan)
    actuation, rest = memory.actuation, estimate.pose
    if not is_immediate(sheet):
        coasted = coast(estimate.pose, memory.actuation, memory.command, dt, sheet)
        actuation, rest = coasted.actuation, coasted.pose
    pose, gains = forward_pose(rest, config), gains_of(sheet, observation.period)
    goal_distance = -forward_pose(goal, config).x
    stands = memory.drive.switching.region == OMEGA_L and memory.command.v == 0.0 and memory.command.omega == 0.0
    now = forward_pose(estimate.pose, config)
    given = StageInput(now, pose, estimate.uncertainty, observation.contact, dt, stands, goal_distance, gains)
    stage = memory.stage
    if stage.phase == STAGING and not _is_contact(goal):
        stage = _begin(UNDOCKING if _is_undocked(goal, goal_distance) else FAILED, stage.tries)
    stage = _next_stage(stage, given, config)
    drive = memory.drive if stage.phase == memory.stage.phase else new_memory()
    if stage.phase == STAGING:
        # After a new goal or a command of the supervisor, the memory of the drive does not contain the current motion.
        moving = with_motion(drive, memory.command, memory.actuation)
        staging = pose_on_axis(config.staging_distance, config.dock_backward)
        drive, command, report = switching_step(moving, observation, staging, config.drive)
        return DockingMemory(stage, command, drive.actuation, drive, False), command, report
    requested = limit_velocity(_requested(stage, pose, goal_distance, gains, config), sheet)
    if config.dock_backward:
        requested = Twist(-requested.v, requested.omega)
    command = limit_change(requested, memory.command, dt, sheet)
    if not math.isfinite(rest.x + rest.y + rest.theta + command.v + command.omega):
        command = Twist(0.0, 0.0)
    rho, alpha, beta = navigation_variables(into_frame(rest, goal))
    report = Report(rho, alpha, beta, rest.theta, CORRIDOR, OMEGA_L, axis_lyapunov(pose, APPROACH_LENGTH))
    reached = stage.phase == DOCKED or stage.phase == UNDOCKED  # noqa: PLR1714 - compiled code compares numbers faster
    return DockingMemory(stage, command, actuation, drive, reached), command, report


def _is_contact(goal: Pose) -> bool:
    return abs(goal.x) <= _UNDOCKED and abs(goal.y) <= _ON_AXIS and abs(goal.theta) <= _ALONG_AXIS


def _is_undocked(goal: Pose, goal_distance: float) -> bool:
    return goal_distance > _UNDOCKED and abs(goal.y) <= _ON_AXIS and abs(goal.theta) <= _ALONG_AXIS


def _next_stage(stage: Stage, given: StageInput, config: DockingConfig) -> Stage:
    phase, distance = stage.phase, -given.rest.x
    if phase == STAGING:
        return _next_staging(stage, given, config)
    if phase == APPROACHING:
        return _next_approach(stage, given, config)
    if phase == RETREATING and distance >= stage.retreat - _UNDOCKED:
        return _begin(FAILED if stage.tries >= config.dock_tries else STAGING, stage.tries)
    if phase == UNDOCKING and distance >= given.goal_distance - _UNDOCKED:
        return _begin(UNDOCKED, stage.tries)
    return stage


def _next_staging(stage: Stage, given: StageInput, config: DockingConfig) -> Stage:
    rest = given.rest
    at_contact = abs(rest.x) <= STRAIGHT_LENGTH and is_within(ContactError(rest.y, rest.theta), 1.0, config)
    if given.contact == CONTACT and at_contact:
        return _begin(DOCKED, stage.tries)  # already docked
    near = STRAIGHT_LENGTH < -rest.x <= config.staging_distance + _NEAR
    if near and is_inside(rest, 1.0) and is_within(contact_error(rest, config), _ENTRY, config):
        return _begin(APPROACHING, stage.tries)
    wait = stage.wait + given.dt if given.stands else 0.0
    if wait > _REST:
        # After this retreat the robot drives along the axis and arrives at the staging pose within the corridor.
        return _begin(RETREATING, stage.tries, config.staging_distance + _ALIGNING)
    return Stage(STAGING, stage.tries, False, wait, math.inf, 0.0)


def _next_approach(stage: Stage, given: StageInput, config: DockingConfig) -> Stage:
    now, rest = given.now, given.rest
    if -now.x <= STRAIGHT_LENGTH and (stage.committed or config.commit_distance <= STRAIGHT_LENGTH):
        return _near_contact(stage, given, config)
    error, distance = contact_error(rest, config), -rest.x
    inside = is_inside(rest, _LEAVE)
    # A contact here, before the dock, means that the robot touches something else or that the pose is wrong.
    will_miss = given.contact == CONTACT or not (inside and is_within(error, 1.0, config))
    if (will_miss and distance > STRAIGHT_LENGTH) or stage.wait > _COMMIT_TIMEOUT:
        return _broken_off(stage, inside, config)
    braking_distance = config.dock_speed * (given.gains.react + 0.5 * config.dock_speed / _brake(given.gains, config))
    if stage.committed or distance > config.commit_distance + braking_distance:
        return stage
    committed = is_certain(error, distance, given.uncertainty, config)
    is_there = not committed and distance <= config.commit_distance + _WAITING
    wait = stage.wait + given.dt if is_there else 0.0
    return Stage(APPROACHING, stage.tries, committed, wait, math.inf, stage.retreat)


def _broken_off(stage: Stage, inside: bool, config: DockingConfig) -> Stage:
    retreat = config.staging_distance + (_MARGIN if inside else _ALIGNING)
    return _begin(RETREATING, stage.tries + 1, retreat)


def _near_contact(stage: Stage, given: StageInput, config: DockingConfig) -> Stage:
    """Return the next stage on the last centimetres of an approach.

    Without a switch, a robot that stands near the dock counts as docked. If a switch reports no contact, the robot
    stands against something else or its odometry is wrong, so it retreats and tries again.
    """
    distance = -given.now.x
    wait, nearest = stage.wait + min(given.dt, _STALL_STEP), stage.nearest
    if distance < nearest - _STALL_DISTANCE:
        wait, nearest = 0.0, distance
    stands = wait > _STALL_TIME and distance <= config.press_distance
    is_beyond = distance <= -config.press_distance
    if given.contact == CONTACT or (given.contact == CONTACT_UNKNOWN and (stands or is_beyond)):
        return _begin(DOCKED, stage.tries)
    if is_beyond or wait > _COMMIT_TIMEOUT:
        return _broken_off(stage, True, config)
    return Stage(APPROACHING, stage.tries, True, wait, nearest, stage.retreat)


def _requested(stage: Stage, pose: Pose, goal_distance: float, gains: Gains, config: DockingConfig) -> Twist:
    """Return the command on the axis, without limits, for a robot that docks with its front."""
    phase, length, distance = stage.phase, APPROACH_LENGTH, -pose.x
    if phase in (RETREATING, UNDOCKING):
        end = stage.retreat + _MARGIN if phase == RETREATING else goal_distance
        return along_axis(pose, -_speed_to(end - distance, gains, config), _RETREAT_LENGTHS * length)
    if phase != APPROACHING:
        return Twist(0.0, 0.0)
    v = min(config.dock_speed, config.contact_speed + _speed_to(distance - STRAIGHT_LENGTH, gains, config))
    if not stage.committed:
        v = min(v, _speed_to(distance - config.commit_distance, gains, config))
    if distance > config.commit_distance:
        return along_axis(pose, v, length)
    return hold_heading(pose, v, length) if distance > STRAIGHT_LENGTH else Twist(v, 0.0)


def _speed_to(distance: float, gains: Gains, config: DockingConfig) -> float:
    """Return the speed [m/s] along the axis from which the robot can stop within ``distance`` [m]."""
    if distance <= 0.0:
        return 0.0
    speed = braking(distance, _brake(gains, config), gains.react)
    # At least the smallest speed that moves the robot.
    return min(config.dock_speed, max(speed, config.drive.data_sheet.min_velocity))


def _brake(gains: Gains, config: DockingConfig) -> float:
    return min(gains.brake, _BRAKE_SHARE * config.drive.data_sheet.a_max)


class StagingLaw(Law):
    """A law that first drives to a staging pose; the field ``drive`` of its Config configures this drive."""

    @staticmethod
    def data_sheet(config: Any) -> DataSheet:
        """Return ``config.drive.data_sheet``."""
        sheet: DataSheet = config.drive.data_sheet
        return sheet

    @staticmethod
    def tolerance(config: Any) -> GoalTolerance:
        """Return ``config.drive.tolerance``."""
        tolerance: GoalTolerance = config.drive.tolerance
        return tolerance


class Docking(StagingLaw):
    """Docking and undocking."""

    name = "docking"
    Config = DockingConfig
    new_memory = staticmethod(new_docking_memory)
    step = staticmethod(docking_step)

    @classmethod
    def memory_for_new_goal(cls, memory: Any, config: Any) -> DockingMemory:
        """Return a new memory with the current motion, for the limits of acceleration and the prediction."""
        return new_docking_memory(config)._replace(command=memory.command, actuation=memory.actuation)

    @staticmethod
    def after_command(memory: Any, command: Twist, dt: float, config: Any) -> DockingMemory:
        """Store the new command and the motion."""
        actuation = after_a_period(memory.actuation, memory.command, dt, config.drive.data_sheet)
        after: DockingMemory = memory._replace(command=command, actuation=actuation)
        return after

    @staticmethod
    def describe(memory: Any, config: Any) -> dict[str, str]:
        """Return the phase, and the number of approaches that were broken off."""
        return {"phase": PHASE_NAMES[memory.stage.phase], "approaches broken off": str(memory.stage.tries)}

    @staticmethod
    def reason_to_give_up(memory: Any, config: Any) -> str:
        """Return why the robot gives up: after the last approach, or because the goal is not on the axis."""
        if memory.stage.phase != FAILED:
            return ""
        if memory.stage.tries == 0:
            return "the goal is neither the docked pose nor on the axis before the dock"
        causes = "the robot was off the axis, too uncertain at commit_distance, or without contact at the dock"
        return f"{memory.stage.tries} approaches broken off: {causes}"
