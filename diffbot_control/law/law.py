"""The base class of control laws, and the guarded calls of a law that the supervisor makes.

A custom law needs a configuration and two functions::

    class MyLaw(Law):
        name = "my_law"
        Config = MyConfig                       # a NamedTuple whose fields carry a Spec

        @staticmethod
        def new_memory(config): ...

        @staticmethod
        def step(memory, observation, goal, config): ...

All functions are pure and receive the memory as an argument, so the node, the simulation and compiled code call the
same functions. A law is never instantiated.
"""

from __future__ import annotations

import math
import traceback
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.limits import is_beyond, limit_change, limit_velocity, slowed
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate

CONTACT_UNKNOWN, NO_CONTACT, CONTACT = -1, 0, 1
"""Contact with the dock. CONTACT_UNKNOWN: no switch reports. NO_CONTACT: the switch is open. CONTACT: the switch is
closed, or a charger supplies the robot."""


class Observation(NamedTuple):
    """Input of a law's step, one for each pose."""

    estimate: Estimate
    """pose of the robot in the frame in which the goal is given, and its standard deviations"""
    dt: float
    """[s] since the last step; 0 at the first step"""
    period: float
    """[s] median time between two poses; a single early or late pose does not change it"""
    contact: int
    """contact with the dock: CONTACT_UNKNOWN, NO_CONTACT or CONTACT"""


class Report(NamedTuple):
    """Variables of a step for ~/navigation and the records.

    If the data sheet has a dead time or a lag, the variables belong to the pose in which the robot would come to rest.
    A law reports nan for a variable that it does not use, and Omega_G (0) if it has no regions.
    """

    rho: float
    """[m] distance to the goal"""
    alpha: float
    """[rad] bearing of the goal in the robot's frame"""
    beta: float
    """[rad] bearing of the goal in the goal's frame"""
    theta: float
    """[rad] heading in the goal's frame"""
    eps_P: float
    """[m] distance from the goal at which the region would change"""
    region: int
    """Omega_G (0) or Omega_L (1)"""
    lyapunov: float
    """value of the Lyapunov function of the region"""


class Law:
    """A control law: it drives a robot to a goal pose, with one command for each pose.

    A subclass has to define ``new_memory`` and ``step``; everything else has a default.
    """

    name: ClassVar[str]
    """name in messages and logs"""
    Config: ClassVar[type[Any]]
    """NamedTuple of the parameters; each field has a default. Fields that carry a :class:`diffbot_core.schema.Spec`
    become ROS parameters of the controller. The fields ``data_sheet: DataSheet`` and ``tolerance: GoalTolerance`` are
    required, unless the law overrides the functions of these names."""
    search_space: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType({})
    """parameters that ``diffbot benchmark tune`` varies, each within its range (low, high)"""

    @staticmethod
    def new_memory(config: Any) -> Any:
        """Return the memory of a robot at rest with a new goal.

        The memory is a NamedTuple with a field ``reached: bool``, True if the goal counts as reached. A law that cannot
        decide this keeps it False.
        """
        raise NotImplementedError

    @staticmethod
    def step(memory: Any, observation: Observation, goal: Pose, config: Any) -> tuple[Any, Twist, Report]:
        """Compute the command for one pose.

        Args:
            memory: memory that the last step returned.
            observation: pose of the robot, its uncertainty, and the time that has passed.
            goal: target pose, in the same frame.
            config: instance of ``Config``.

        Returns:
            The next memory, the command [m/s], [rad/s], and the report. The supervisor limits the command to the data
            sheet; see :meth:`after_command`.
        """
        raise NotImplementedError

    @staticmethod
    def data_sheet(config: Any) -> DataSheet:
        """Return the limits of the robot, for all its commands. Default: ``config.data_sheet``."""
        sheet: DataSheet = config.data_sheet
        return sheet

    @staticmethod
    def tolerance(config: Any) -> GoalTolerance:
        """Return the tolerances of the goal. Default: ``config.tolerance``."""
        tolerance: GoalTolerance = config.tolerance
        return tolerance

    @classmethod
    def memory_for_new_goal(cls, memory: Any, config: Any) -> Any:
        """Return the memory for a new goal while the robot moves. Default: the memory of a robot at rest.

        A law that limits accelerations itself, or that predicts over a dead time, has to keep the motion.
        """
        return cls.new_memory(config)

    @staticmethod
    def after_command(memory: Any, command: Twist, dt: float, config: Any) -> Any:
        """Return the memory after the supervisor has sent a command of its own. Default: unchanged.

        The supervisor calls this function in three cases. If it has limited the command of a step, ``dt`` is 0, and
        ``command`` replaces the command of the step. If it brakes without the law, ``dt`` [s] is the time since the
        previous command. Before a new goal, ``command`` is zero, and ``dt`` is the time at rest since the last goal.
        """
        return memory

    @staticmethod
    def describe(memory: Any, config: Any) -> dict[str, str]:
        """Return key-value pairs about the memory for ~/status. Default: none."""
        return {}

    @staticmethod
    def reason_to_give_up(memory: Any, config: Any) -> str:
        """Return why the robot will not reach the goal; a string that is not empty ends the goal. Default: empty."""
        return ""


class LawError(DiffbotError):
    """A law raised an error, or returned something that cannot be used."""


class errors_of:  # noqa: N801 - used as a function; a generator would be slower, and each step uses it
    """Context that converts an error of the law to a LawError of one line, with the type and the place of the error."""

    def __init__(self, law: type[Law]) -> None:
        """Store the law, whose name the LawError contains."""
        self._law = law

    def __enter__(self) -> None:
        """Enter the block."""

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        """Raise a LawError if the block has raised an error."""
        if not isinstance(error, Exception) or isinstance(error, LawError):
            return
        frames = traceback.extract_tb(trace)
        place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
        text = f"law {self._law.name} failed: {type(error).__name__}: {error} ({place})"
        raise LawError(" ".join(text.split())) from error


class Step(NamedTuple):
    """Result of a step, with the command within the limits."""

    memory: Any
    command: Twist
    report: Report
    reason_to_give_up: str
    """why the law gives the goal up; empty if the law continues"""
    data_sheet: DataSheet
    tolerance: GoalTolerance


def guarded_step(law: type[Law], memory: Any, observation: Observation, goal: Pose, last: Twist, config: Any) -> Step:
    """Call the step of a law and keep its command within the limits of its data sheet.

    Args:
        law: any law.
        memory: memory of the law.
        observation: input of the step.
        goal: target pose, in the frame of the estimate.
        last: previous command.
        config: configuration of the law.

    Raises:
        LawError: if the law raises an error, or its result is not finite or not as :class:`Law` defines it.
    """
    with errors_of(law):
        sheet, tolerance = law.data_sheet(config), law.tolerance(config)
        after, (v, omega), report = law.step(memory, observation, goal, config)
        command = Twist(float(v), float(omega))
        if not (math.isfinite(command.v) and math.isfinite(command.omega)):
            raise LawError(f"law {law.name} failed: its command is not finite: v = {v} m/s, omega = {omega} rad/s")
        float(sum(report))  # raises if a variable is not a number
        if after.reached not in (True, False):
            raise LawError(f"law {law.name} failed: memory.reached is {after.reached!r}: must be True or False")
        if len(report) != len(Report._fields):
            raise LawError(f"law {law.name} failed: its report has {len(report)} of {len(Report._fields)} variables")
        bounded = limit_velocity(command, sheet) if is_beyond(command, sheet) else command
        limited = limit_change(bounded, last, observation.dt, sheet)
        if limited != command:
            after = law.after_command(after, limited, 0.0, config)
        return Step(after, limited, report, str(law.reason_to_give_up(after, config)), sheet, tolerance)


def braking_step(law: type[Law], memory: Any, last: Twist, dt: float, config: Any) -> tuple[Any, Twist]:
    """Brake without a goal: return memory and command ``dt`` [s] after the command ``last``.

    Raises:
        LawError: if the law raises an error.
    """
    with errors_of(law):
        command = slowed(last, dt, law.data_sheet(config))
        return law.after_command(memory, command, dt, config), command
