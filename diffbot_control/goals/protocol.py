"""What a control law has to offer, this project's own and those of others."""

from __future__ import annotations

from typing import Any, Protocol

from diffbot_control.law.configuration import Report
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate


class Law(Protocol):
    """A law: a class or an object with these names, whose functions are pure.

    ``Config`` is a NamedTuple whose fields carry a ``Spec`` and a default, one of them ``data_sheet: DataSheet``.
    The memory is a NamedTuple with a field ``reached: bool``; a law that cannot say whether the goal is reached leaves
    it False. Two more fields outlive a goal, since they describe the robot's motion: ``command: Twist``, the last
    command, and ``actuation: Actuation``, the commands under way (:mod:`diffbot_control.law.latency`). Both are kept
    for a new goal, and follow the robot while it comes to rest without one.

    A law may also have ``reason_to_give_up(memory, config) -> str``, not empty where it will not reach the goal, and
    ``describe(memory) -> dict[str, str]``, which ~/status shows. A memory with the field ``contact: bool`` is told on
    ``dock_contact`` and ``battery_state`` that the robot touches its dock.
    """

    name: str
    Config: type[Any]

    def new_memory(self, config: Any) -> Any:
        """Return the memory at rest with a new goal."""
        ...

    def step(self, memory: Any, estimate: Estimate, goal: Pose, dt: float, config: Any) -> tuple[Any, Twist, Report]:
        """Answer an estimate: the next memory, the command, and what the step worked with.

        Args:
            memory: as left by the last step.
            estimate: pose of the robot in the frame of ``goal``, and its standard deviations.
            goal: target pose.
            dt: [s] since the last step; 0 at the first one.
            config: parameters and data sheet.
        """
        ...


def data_sheet_of(config: Any) -> DataSheet | None:
    """Return the data sheet in the configuration of a law; None if the law does not have one."""
    sheet = getattr(config, "data_sheet", None)
    return sheet if isinstance(sheet, DataSheet) else None


def tolerance_of(config: Any) -> GoalTolerance:
    """Return the tolerances in the configuration of a law; the defaults if the law does not have any."""
    tolerance = getattr(config, "tolerance", None)
    return tolerance if isinstance(tolerance, GoalTolerance) else GoalTolerance()
