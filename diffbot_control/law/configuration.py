"""Configuration, memory and report of the controller."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.law.finish import Finish, FinishConfig, no_finish
from diffbot_control.law.goal_checker import GoalTolerance, Settling
from diffbot_control.law.latency import Actuation, resting_actuation
from diffbot_control.law.lyapunov_law import Gains
from diffbot_control.law.paper.reapproach import RESTING, Reapproach, ReapproachConfig
from diffbot_control.law.regions import OMEGA_G, RegionPolicy, Switching
from diffbot_control.law.speed_profile import ProfileGains
from diffbot_control.law.steering import UNDECIDED, Course
from diffbot_core.data_sheet import DataSheet
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec, known_fields

TANH, BRAKING = 0, 1
PROFILE_NAMES = ("tanh", "braking")
"""Words of the parameter ``speed_profile``; compiled code compares their indices."""
GIVEN, AUTO = 0, 1
GAIN_SOURCES = ("preset", "auto")
"""Words of the parameter ``gains``."""


@known_fields
class Driving(NamedTuple):
    """How the robot may move."""

    allow_backward: Annotated[
        bool, Spec("reverse towards a goal behind the robot; otherwise turn on the spot until it is in front")
    ] = True
    symmetric_yaw_tolerance: Annotated[
        bool, Spec("the opposite heading at the goal is as good (speed_profile braking)")
    ] = False


@known_fields
class ControllerConfig(NamedTuple):
    """All that shapes the command. The defaults are the preset ``tuned``, as in the node; presets.py has the others."""

    profile: Annotated[
        int,
        Spec(
            "law: the paper's with gamma tanh(rho), or with profiles that brake within the limits and know the latency",
            choices=PROFILE_NAMES,
            parameter="speed_profile",
        ),
    ] = BRAKING
    gain_source: Annotated[
        int,
        Spec(
            "gains of speed_profile braking: the parameters, or derived from period, latency and limits",
            choices=GAIN_SOURCES,
            parameter="gains",
        ),
    ] = GIVEN
    gains: Gains = Gains()
    """of the paper's law"""
    profile_gains: ProfileGains = ProfileGains()
    """of the law with braking profiles"""
    region_policy: RegionPolicy = RegionPolicy()
    data_sheet: DataSheet = DataSheet()
    tolerance: GoalTolerance = GoalTolerance()
    uncertainty_scale: Annotated[
        float, Spec("factor of the estimate's standard deviations, for an overconfident filter", "-", 0.0, 100.0)
    ] = 1.0
    reapproach: ReapproachConfig = ReapproachConfig()
    """of the paper's law with the covariance policy"""
    finish: FinishConfig = FinishConfig()
    """of the law with braking profiles"""
    driving: Driving = Driving()


class ControllerMemory(NamedTuple):
    """What one step passes to the next; the default is the state at rest with a new goal."""

    switching: Switching = Switching()
    command: Twist = Twist(0.0, 0.0)
    """the last one"""
    settling: Settling = Settling()
    reapproach: Reapproach = Reapproach()
    finish: Finish = Finish()
    course: Course = Course()
    actuation: Actuation = Actuation()
    reached: bool = False
    """the goal counts as reached"""


class Report(NamedTuple):
    """The variables of a step and its decisions, for ~/navigation and the records.

    With a latency they are those of the pose in which the robot will come to rest, as the law sees it.
    """

    rho: float
    """[m]"""
    alpha: float
    """[rad]"""
    beta: float
    """[rad]"""
    theta: float
    """[rad] heading in the goal's frame"""
    eps_P: float
    """[m] radius at which the region would change from here"""
    region: int
    lyapunov: float
    """V of Eq. (8) in Omega_G, of Eq. (15) in Omega_L"""


def new_memory() -> ControllerMemory:
    """Return the memory at rest with a new goal, every field given: compiled code does not know the defaults."""
    return ControllerMemory(
        switching=Switching(region=OMEGA_G, switches=0, steps_outside=0),
        command=Twist(0.0, 0.0),
        settling=Settling(steps_within=0, reached=False),
        reapproach=Reapproach(phase=RESTING, tries=0, quiet_steps=0, time=0.0, retreat_distance=0.0),
        finish=no_finish(),
        course=Course(leading=UNDECIDED, turned=False),
        actuation=resting_actuation(),
        reached=False,
    )
