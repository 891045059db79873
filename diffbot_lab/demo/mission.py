"""Going through a list of goals: when to send the next one, when to give up. Free of ROS."""

from __future__ import annotations

from typing import NamedTuple

from diffbot_core.geometry import Pose


class Leg(NamedTuple):
    """One goal of the list as it went."""

    goal: Pose
    started: float
    """[s] time of the first news after it was sent"""
    ended: float
    """[s]"""
    reached: bool


class Mission:
    """Fed with what the controller tells, it says which goal to send. Times are of the simulation [s]."""

    def __init__(self, goals: list[Pose], hold: float, timeout: float) -> None:
        """Drive to ``goals`` in order; stay ``hold`` [s] at each; give up after ``timeout`` [s] at one."""
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
        """Whether all goals were reached or one was given up."""
        return len(self.legs) == len(self.goals) or self.gave_up

    @property
    def gave_up(self) -> bool:
        """Whether the last goal was not reached in time."""
        return bool(self.legs) and not self.legs[-1].reached

    @property
    def goal(self) -> Pose:
        """The goal to drive to now, the last one at the end."""
        return self.goals[min(len(self.legs), len(self.goals) - 1)]

    @property
    def progress(self) -> float:
        """Share of the whole, 0 to 1, by distance within each leg."""
        share = 0.0
        if not self.done and self._first_distance:
            share = 1.0 if self._reached_at is not None else max(0.0, 1.0 - self._distance / self._first_distance)
        return (len(self.legs) + share) / len(self.goals)

    def on_navigation(self, time: float, distance: float) -> bool:
        """Take the distance to the goal at a time; True if the next goal is to be sent now."""
        if self.done:
            return False
        self._time = time
        self._started = time if self._started is None else self._started
        # The largest: news of the goal before may still be on its way.
        self._first_distance = max(self._first_distance, distance)
        self._distance = distance
        if self._reached_at is not None and time - self._reached_at >= self._hold:
            return self._end_leg(time, True)
        if self._reached_at is None and time - self._started > self._timeout:
            return self._end_leg(time, False)
        return False

    def on_goals_reached(self, count: int) -> None:
        """Take the controller's count of goals reached since this mission began."""
        if count > len(self.legs) and self._reached_at is None and self._started is not None:
            self._reached_at = self._time

    def _end_leg(self, time: float, reached: bool) -> bool:
        self.legs.append(Leg(self.goal, time if self._started is None else self._started, time, reached))
        self._started = self._reached_at = None
        self._first_distance = 0.0
        return not self.done
