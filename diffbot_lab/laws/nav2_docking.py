"""Nav2's docking server as a law: to a staging pose, then by the graceful law to the dock; defaults of release Jazzy.

Source: github.com/ros-navigation/navigation2, nav2_docking: approachDock and its retries in docking_server.cpp, gains
and speeds in controller.cpp. As in :mod:`diffbot_control.law.docking`, poses and goal are in the dock's frame. Three
things are in favour of this peer: it drives to the staging pose by this project's switching law, it has the estimate of
a filter instead of a smoothed detection, so that no try fails for a lost one, and it presses on to contact.
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
"""Phases: before the first pose, to the staging pose, by the graceful law, straight on to contact, at rest for good."""


class Nav2DockingConfig(NamedTuple):
    """Parameters and defaults of the docking server, Jazzy; ``drive`` is the law that drives to the staging pose.

    Nav2 holds the robot docked within ``docking_threshold``; here it drives straight on from there, at the least speed,
    until the estimate is ``press_distance`` beyond the docked pose.
    """

    dock_backward: Annotated[bool, Spec("the back of the robot docks")] = False
    staging_distance: Annotated[float, Spec("distance of the staging pose from the docked one", "m", 0.05, 10.0)] = 0.7
    dock_prestaging_tolerance: Annotated[float, Spec("no staging within this distance", "m", 0.0, 10.0)] = 0.5
    docking_threshold: Annotated[float, Spec("distance within which the robot is docked", "m", 0.0, 1.0)] = 0.05
    dock_approach_timeout: Annotated[float, Spec("an approach may take so long", "s", 0.1, 3600.0)] = 30.0
    max_retries: Annotated[int, Spec("approaches after the first one", minimum=0, maximum=100)] = 3
    press_distance: Annotated[float, Spec("how far beyond the docked pose it drives on", "m", 0.0, 1.0)] = 0.03
    k_phi: Annotated[float, Spec("k_1 of Park and Kuipers", "-", 0.0, 20.0)] = 3.0
    k_delta: Annotated[float, Spec("k_2 of Park and Kuipers", "-", 0.0, 20.0)] = 2.0
    beta: Annotated[float, Spec("weight of the curvature in the speed", "m^lambda", 0.0, 10.0)] = 0.4
    lambda_: Annotated[float, Spec("exponent of the curvature in the speed", "-", 0.5, 5.0, parameter="lambda")] = 2.0
    v_linear_min: Annotated[float, Spec("least speed", "m/s", 0.0, 1.0)] = 0.1
    v_linear_max: Annotated[float, Spec("bound of the speed", "m/s", 0.01, 10.0)] = 0.25
    v_angular_max: Annotated[float, Spec("bound of the turn rate", "rad/s", 0.01, 20.0)] = 0.75
    slowdown_radius: Annotated[float, Spec("the speed falls in proportion below this distance", "m", 0.05, 10.0)] = 0.25
    drive: SwitchingConfig = SwitchingConfig()


class Docker(NamedTuple):
    """State of the law from step to step."""

    phase: int
    tries: int
    """approaches that took too long"""
    age: float
    """[s] of the approach"""
    drive: SwitchingMemory
    """of the law that drives to the staging pose"""


def approach(lead: Pose, config: Nav2DockingConfig) -> Twist:
    """Return the command of the graceful law towards the dock, of the end that leads, at its pose before the dock."""
    dock = into_frame(Pose(0.0, 0.0, 0.0), lead)
    return smooth_velocity(dock.x, dock.y, dock.theta, config)


def next_docker(docker: Docker, lead: Pose, dt: float, config: Nav2DockingConfig) -> Docker:
    """Return the memory with the phase at a pose of the end that leads."""
    phase, tries, age = docker.phase, docker.tries, docker.age
    if phase == UNDECIDED:
        is_near = math.hypot(lead.x + config.staging_distance, lead.y) < config.dock_prestaging_tolerance
        phase = APPROACHING if is_near else STAGING
    elif phase == STAGING and docker.drive.reached:
        phase, age = APPROACHING, 0.0
    elif phase == APPROACHING:
        age += dt
        if math.hypot(lead.x, lead.y) < config.docking_threshold:
            phase = PRESSING
        elif age > config.dock_approach_timeout:
            phase, tries = (ENDED if tries >= config.max_retries else STAGING), tries + 1
    elif phase == PRESSING and lead.x >= config.press_distance:
        phase = ENDED
    return Docker(phase, tries, age, docker.drive)


class Nav2Docking(StagingLaw):
    """Nav2's docking server with its graceful controller."""

    name = "nav2_docking"
    Config = Nav2DockingConfig

    @staticmethod
    def new_memory(config: Any) -> LawMemory:
        """Return the memory of a robot at rest with a new goal."""
        return new_law_memory(Docker(UNDECIDED, 0, 0.0, new_memory()))

    @staticmethod
    def step(
        memory: LawMemory, observation: Observation, goal: Pose, config: Nav2DockingConfig
    ) -> tuple[LawMemory, Twist, Report]:
        """Answer one pose. The approach does not look ahead over latencies; commands are kept within the data sheet."""
        sign = -1.0 if config.dock_backward else 1.0
        estimate, dt = observation.estimate, observation.dt
        pose = into_frame(estimate.pose, goal)
        # The pose of the leading end: a robot that docks with its back is seen in the frame turned round.
        lead = Pose(sign * pose.x, sign * pose.y, pose.theta)
        now = situation_of(memory, observation, goal, config.drive.data_sheet)
        docker = next_docker(memory.state, lead, dt, config)
        if docker.phase == STAGING:
            begun = docker.drive
            if memory.state.phase != STAGING:
                begun = with_motion(new_memory(), memory.command, memory.actuation)
            staging = Pose(-sign * config.staging_distance, 0.0, 0.0)
            seen = Observation(Estimate(pose, estimate.uncertainty), dt, observation.period, observation.contact)
            drive, command, report = switching_step(begun, seen, staging, config.drive)
            state = Docker(STAGING, docker.tries, 0.0, drive)
            return LawMemory(state, drive.actuation, command, memory.settling, False), command, report
        requested = STOP
        if docker.phase == APPROACHING:
            requested = approach(lead, config)
        elif docker.phase == PRESSING:
            requested = Twist(config.v_linear_min, 0.0)
        along = Twist(sign * requested.v, requested.omega)
        return conclude(docker, along, now, config.drive.tolerance, config.drive.data_sheet)
