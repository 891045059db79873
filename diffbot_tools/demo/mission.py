"""A list of goals: when to send the next one, and when to give up. Free of ROS."""

from __future__ import annotations

from typing import NamedTuple

from diffbot_core.geometry import Pose


class Leg(NamedTuple):
    """Outcome of one goal."""

    goal: Pose
    started: float
    """[s] time of the first message about it"""
    ended: float
    """[s]"""
    reached: bool


class Mission:
    """Takes the controller's reports and decides which goal to send next. Times are in simulated seconds."""

    def __init__(self, goals: list[Pose], hold: float, timeout: float) -> None:
        """Drive to ``goals`` in order, hold each for ``hold`` [s], give up a goal after ``timeout`` [s]."""
        self.goals = goals
        self.legs: list[Leg] = []
        self._hold = hold
        self._timeout = timeout
        self._started: float | None = None
        self._reached_at: float | None = None
        self._time = 0.0
        self._first_distance = 0.0
        self._distance = 0.0

    @property
    def done(self) -> bool:
        """True if all goals were reached or one was given up."""
        return len(self.legs) == len(self.goals) or self.gave_up

    @property
    def gave_up(self) -> bool:
        """True if the latest goal was not reached in time."""
        return bool(self.legs) and not self.legs[-1].reached

    @property
    def goal(self) -> Pose:
        """The current goal; after the end, the last one."""
        return self.goals[min(len(self.legs), len(self.goals) - 1)]

    @property
    def progress(self) -> float:
        """Share of the mission done, 0 to 1; within a leg by distance."""
        share = 0.0
        if not self.done and self._first_distance:
            share = 1.0 if self._reached_at is not None else max(0.0, 1.0 - self._distance / self._first_distance)
        return (len(self.legs) + share) / len(self.goals)

    def on_navigation(self, time: float, distance: float) -> bool:
        """Process the distance [m] to the goal at a time [s]; return True if the next goal is to be sent now."""
        if self.done:
            return False
        self._time = time
        self._started = time if self._started is None else self._started
        # The largest distance: a late message may still refer to the previous goal.
        self._first_distance = max(self._first_distance, distance)
        self._distance = distance
        if self._reached_at is not None and time - self._reached_at >= self._hold:
            return self._end_leg(time, True)
        if self._reached_at is None and time - self._started > self._timeout:
            return self._end_leg(time, False)
        return False

    def on_goals_reached(self, count: int) -> None:
        """Process the controller's count of goals reached since the mission began."""
        if count > len(self.legs) and self._reached_at is None and self._started is not None:
            self._reached_at = self._time

    def _end_leg(self, time: float, reached: bool) -> bool:
        self.legs.append(Leg(self.goal, time if self._started is None else self._started, time, reached))
        self._started = self._reached_at = None
        self._first_distance = 0.0
        return not self.done
