"""What a control law is, a base class with documented defaults, and how the supervisor calls any law.

A law of one's own needs a configuration and two functions::

    class MyLaw(Law):
        name = "my_law"
        Config = MyConfig                       # a NamedTuple whose fields carry a Spec

        @staticmethod
        def new_memory(config): ...

        @staticmethod
        def step(memory, observation, goal, config): ...

All functions are pure and take the memory as an argument, so that a node, a simulation and compiled code can call the
same ones. A law is never instantiated.
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

STOP = Twist(0.0, 0.0)
CONTACT_UNKNOWN, NO_CONTACT, CONTACT = -1, 0, 1
"""Contact with the dock: nobody reports it; a switch is open; a switch is closed, or the charger supplies the robot."""


class Observation(NamedTuple):
    """Input of a law's step, one for each pose."""

    estimate: Estimate
    """pose of the robot in the frame of the goal, and its standard deviations"""
    dt: float
    """[s] since the last step; 0 at the first one"""
    period: float
    """[s] median time between two poses, which a single early or late pose does not change"""
    contact: int
    """with the dock, one of CONTACT_UNKNOWN, NO_CONTACT and CONTACT"""


class Report(NamedTuple):
    """Variables of a step for ~/navigation and the records.

    With a latency they belong to the pose in which the robot would come to rest. A law gives nan for a variable that it
    does not have, and Omega_G (0) if it has no regions.
    """

    rho: float
    """[m] distance of the goal"""
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
    """NamedTuple of the parameters. Fields that carry a :class:`diffbot_core.schema.Spec` become ROS parameters of the
    controller; each field has a default. It has the fields ``data_sheet: DataSheet`` and ``tolerance: GoalTolerance``,
    unless the law overrides the functions of these names."""
    search_space: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType({})
    """parameters that ``diffbot benchmark tune`` tunes, within (low, high)"""

    @staticmethod
    def new_memory(config: Any) -> Any:
        """Return the memory of a robot at rest with a new goal.

        The memory is a NamedTuple with a field ``reached: bool``, True if the goal counts as reached. A law that cannot
        decide this keeps it False.
        """
        raise NotImplementedError

    @staticmethod
    def step(memory: Any, observation: Observation, goal: Pose, config: Any) -> tuple[Any, Twist, Report]:
        """Answer one pose.

        Args:
            memory: result of the last step.
            observation: pose of the robot, its uncertainty, and the time that has passed.
            goal: target pose, in the same frame.
            config: instance of ``Config``.

        Returns:
            The next memory, the command [m/s], [rad/s], and the report. The caller keeps the command within the limits
            of the data sheet; see :meth:`after_command`.
        """
        raise NotImplementedError

    @staticmethod
    def data_sheet(config: Any) -> DataSheet:
        """Return the limits of the robot, which every command has to keep. Default: ``config.data_sheet``."""
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
        """Return the memory after a command that the law did not give. Default: unchanged.

        The supervisor calls it if it had to limit the command of a step (``dt`` is 0: the command replaces that of the
        step), and for each command with which it brings the robot to rest (``dt`` [s] is the time since the command
        before).
        """
        return memory

    @staticmethod
    def describe(memory: Any, config: Any) -> dict[str, str]:
        """Return the key-value pairs of the memory that ~/status shows. Default: none."""
        return {}

    @staticmethod
    def reason_to_give_up(memory: Any, config: Any) -> str:
        """Return why the robot will not reach the goal, which ends the goal. Default: empty, the robot goes on."""
        return ""


class LawError(DiffbotError):
    """A law raised an error, or its answer cannot be used."""


class errors_of:  # noqa: N801 - read as ``with errors_of(law):``; a generator would take longer at each step
    """Turn an error of the law in the ``with`` block into a LawError of one line that names the place."""

    def __init__(self, law: type[Law]) -> None:
        """Store the law, whose name the error contains."""
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
    """Result of a law's step."""

    memory: Any
    command: Twist
    """within the limits of the data sheet"""
    report: Report
    hopeless: str
    """why the law gives the goal up; empty if it goes on"""
    data_sheet: DataSheet
    tolerance: GoalTolerance


def guarded_step(law: type[Law], memory: Any, observation: Observation, goal: Pose, last: Twist, config: Any) -> Step:
    """Call the step of a law and keep its command within the limits of its data sheet.

    Args:
        law: any law.
        memory: of the law.
        observation: of this step.
        goal: in the frame of the estimate.
        last: the previous command.
        config: of the law.

    Raises:
        LawError: if the law raises an error, or its answer is not finite or is not what :class:`Law` defines.
    """
    with errors_of(law):
        sheet, tolerance = law.data_sheet(config), law.tolerance(config)
        after, (v, omega), report = law.step(memory, observation, goal, config)
        command = Twist(float(v), float(omega))
        if not (math.isfinite(command.v) and math.isfinite(command.omega)):
            raise LawError(f"law {law.name} failed: v = {v} m/s, omega = {omega} rad/s: must be finite")
        float(sum(report))  # raises if a variable is not a number
        if after.reached not in (True, False) or len(report) != len(Report._fields):
            raise LawError(f"law {law.name} failed: 'reached' or the report is not as the class Law says")
        bounded = limit_velocity(command, sheet) if is_beyond(command, sheet) else command
        within = limit_change(bounded, last, observation.dt, sheet)
        if within != command:
            after = law.after_command(after, within, 0.0, config)
        return Step(after, within, report, str(law.reason_to_give_up(after, config)), sheet, tolerance)


def braking_step(law: type[Law], memory: Any, last: Twist, dt: float, config: Any) -> tuple[Any, Twist]:
    """Return memory and command of one step of braking without a goal, ``dt`` [s] after the command ``last``.

    Raises:
        LawError: if the law raises an error.
    """
    with errors_of(law):
        command = slowed(last, dt, law.data_sheet(config))
        return law.after_command(memory, command, dt, config), command
