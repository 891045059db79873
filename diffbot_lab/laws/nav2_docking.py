"""Nav2's docking server as a law, with the defaults of release Jazzy.

The robot drives to a staging pose, and then to the dock with the graceful law. Poses and goal are in the dock's frame,
as in :mod:`diffbot_control.law.docking`.

Source: github.com/ros-navigation/navigation2, nav2_docking: approachDock and its retries in docking_server.cpp, gains
and speeds in controller.cpp. Three differences help this law. It drives to the staging pose with this project's
switching law. It uses the estimate of a filter instead of a smoothed detection, so a lost detection does not end an
approach. It drives straight on until contact.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_control.law.docking import StagingLaw
from diffbot_control.law.law import Observation, Report
from diffbot_control.law.switching import SwitchingMemory, new_memory, with_motion
from diffbot_control.law.switching import step as switching_step
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import Estimate
from diffbot_lab.laws.common import STOP, LawMemory, conclude, new_law_memory, situation_of
from diffbot_lab.laws.nav2_graceful import smooth_velocity

UNDECIDED, STAGING, APPROACHING, PRESSING, ENDED = 0, 1, 2, 3, 4
"""Phases: before the first pose, driving to the staging pose, driving by the graceful law, driving straight on until
contact, at rest."""


class Nav2DockingConfig(NamedTuple):
    """Parameters and defaults of the docking server, Jazzy. ``drive`` configures the drive to the staging pose.

    Nav2 considers the robot docked within ``docking_threshold``. Here the robot drives straight on from there at the
    smallest speed, until the estimate is ``press_distance`` beyond the docked pose.
    """

    dock_backward: Annotated[bool, Spec("the back of the robot docks")] = False
    staging_distance: Annotated[float, Spec("distance of the staging pose from the docked pose", "m", 0.05, 10.0)] = 0.7
    dock_prestaging_tolerance: Annotated[
        float, Spec("distance from the staging pose within which the robot skips it", "m", 0.0, 10.0)
    ] = 0.5
    docking_threshold: Annotated[float, Spec("distance within which the robot is docked", "m", 0.0, 1.0)] = 0.05
    dock_approach_timeout: Annotated[float, Spec("largest duration of an approach", "s", 0.1, 3600.0)] = 30.0
    max_retries: Annotated[int, Spec("largest number of further approaches", minimum=0, maximum=100)] = 3
    press_distance: Annotated[
        float, Spec("distance beyond the docked pose at which the robot stops", "m", 0.0, 1.0)
    ] = 0.03
    k_phi: Annotated[float, Spec("k_1 of Park and Kuipers", "-", 0.0, 20.0)] = 3.0
    k_delta: Annotated[float, Spec("k_2 of Park and Kuipers", "-", 0.0, 20.0)] = 2.0
    beta: Annotated[float, Spec("weight of the curvature in the speed", "m^lambda", 0.0, 10.0)] = 0.4
    lambda_: Annotated[float, Spec("exponent of the curvature in the speed", "-", 0.5, 5.0, parameter="lambda")] = 2.0
    v_linear_min: Annotated[float, Spec("smallest speed", "m/s", 0.0, 1.0)] = 0.1
    v_linear_max: Annotated[float, Spec("largest speed", "m/s", 0.01, 10.0)] = 0.25
    v_angular_max: Annotated[float, Spec("largest turn rate", "rad/s", 0.01, 20.0)] = 0.75
    slowdown_radius: Annotated[float, Spec("distance below which the speed is proportional to it", "m", 0.05, 10.0)] = (
        0.25
    )
    drive: SwitchingConfig = SwitchingConfig()


class DockingState(NamedTuple):
    """State of the law between steps."""

    phase: int
    retries: int
    """number of approaches that exceeded the timeout"""
    age: float
    """[s] duration of the approach so far"""
    drive: SwitchingMemory
    """memory of the drive to the staging pose"""


def approach(forward: Pose, config: Nav2DockingConfig) -> Twist:
    """Return the command of the graceful law to the dock, for the pose of a robot that docks with its front."""
    dock = into_frame(Pose(0.0, 0.0, 0.0), forward)
    return smooth_velocity(dock.x, dock.y, dock.theta, config)


def next_state(state: DockingState, forward: Pose, dt: float, config: Nav2DockingConfig) -> DockingState:
    """Return the state at the next pose, which is the pose of a robot that docks with its front."""
    phase, retries, age = state.phase, state.retries, state.age
    if phase == UNDECIDED:
        is_near = math.hypot(forward.x + config.staging_distance, forward.y) < config.dock_prestaging_tolerance
        phase = APPROACHING if is_near else STAGING
    elif phase == STAGING and state.drive.reached:
        phase, age = APPROACHING, 0.0
    elif phase == APPROACHING:
        age += dt
        if math.hypot(forward.x, forward.y) < config.docking_threshold:
            phase = PRESSING
        elif age > config.dock_approach_timeout:
            phase, retries = (ENDED if retries >= config.max_retries else STAGING), retries + 1
    elif phase == PRESSING and forward.x >= config.press_distance:
        phase = ENDED
    return DockingState(phase, retries, age, state.drive)


class Nav2Docking(StagingLaw):
    """Nav2's docking server with its graceful controller."""

    name = "nav2_docking"
    Config = Nav2DockingConfig

    @staticmethod
    def new_memory(config: Any) -> LawMemory:
        """Return the memory of a robot at rest with a new goal."""
        return new_law_memory(DockingState(UNDECIDED, 0, 0.0, new_memory()))

    @staticmethod
    def step(
        memory: LawMemory, observation: Observation, goal: Pose, config: Nav2DockingConfig
    ) -> tuple[LawMemory, Twist, Report]:
        """Answer one pose, within the data sheet. The approach does not predict over latencies."""
        sign = -1.0 if config.dock_backward else 1.0
        estimate, dt = observation.estimate, observation.dt
        pose = into_frame(estimate.pose, goal)
        # If the robot docks with its back, turn the dock's frame and the robot by pi.
        forward = Pose(sign * pose.x, sign * pose.y, pose.theta)
        now = situation_of(memory, observation, goal, config.drive.data_sheet)
        state = next_state(memory.state, forward, dt, config)
        if state.phase == STAGING:
            drive = state.drive
            if memory.state.phase != STAGING:
                drive = with_motion(new_memory(), memory.command, memory.actuation)
            staging = Pose(-sign * config.staging_distance, 0.0, 0.0)
            local = Observation(Estimate(pose, estimate.uncertainty), dt, observation.period, observation.contact)
            drive, command, report = switching_step(drive, local, staging, config.drive)
            state = DockingState(STAGING, state.retries, 0.0, drive)
            return LawMemory(state, drive.actuation, command, memory.settling, False), command, report
        requested = STOP
        if state.phase == APPROACHING:
            requested = approach(forward, config)
        elif state.phase == PRESSING:
            requested = Twist(config.v_linear_min, 0.0)
        signed = Twist(sign * requested.v, requested.omega)
        return conclude(state, signed, now, config.drive.tolerance, config.drive.data_sheet)
