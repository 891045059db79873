"""What the controller does between messages: goals, silence, coming to rest. Free of ROS; time in seconds."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.config import Spec
from diffbot_control.controller import (
    ControllerConfig,
    ControllerMemory,
    Report,
    memory_for_new_goal,
    step,
    stop_step,
)
from diffbot_control.geometry import Pose
from diffbot_control.kinematics import Twist

IDLE = "idle"
WAITING = "waiting for pose"
DRIVING = "driving"
REACHED = "goal reached"
STALE = "stale pose"
STATES = (IDLE, WAITING, DRIVING, REACHED, STALE)
"""Messages of ~/status, all there are."""

_LONGEST_STEP = 1.0
"""[s] longer gaps between poses give the acceleration limits no more room than this."""
_STOP_REPEATS = 5
"""Zero commands sent after a stop, so that one lost message does not leave the robot driving."""


class SupervisorConfig(NamedTuple):
    """Options of the controller beyond the law."""

    controller: ControllerConfig = ControllerConfig()
    pose_timeout: Annotated[
        float, Spec("without a pose for so long the robot is stopped", "s", minimum=0.0, above=True)
    ] = 0.5
    hold_goal: Annotated[bool, Spec("keep controlling at a reached goal; otherwise go idle")] = True
    publish_when_idle: Annotated[
        bool, Spec("answer every pose, with zero when there is no goal (lock-step needs it)")
    ] = False


class Supervisor:
    """Turns goals, poses and the passing of time into commands; each method returns the command to send, or None."""

    def __init__(self, config: SupervisorConfig) -> None:
        """Start idle."""
        self.config = config
        self.memory = ControllerMemory()
        self.goal: Pose | None = None
        self.state = IDLE
        self.report: Report | None = None
        self.goals_reached = 0
        """goals reached so far; one that is lost and reached again, or held through silence, counts once"""
        self._counted = False
        self._stamp: int | None = None
        self._heard: float | None = None
        self._zeros_due = 0

    def on_goal(self, goal: Pose) -> None:
        """Drive to ``goal`` (frame of the poses) from the next pose on; the newest goal wins."""
        self.goal = goal
        self.memory = memory_for_new_goal(self.memory)
        self.state = WAITING if self._heard is None else DRIVING
        self.report = None
        self._counted = False

    def on_cancel(self) -> Twist | None:
        """Give up the goal, if there is one, and begin to come to rest at once, pose or no pose."""
        if self.goal is None:
            return None
        self._go_idle(IDLE)
        return None if self.config.publish_when_idle else self._come_to_rest(0.0)

    def on_pose(self, stamp: int, now: float, pose: Pose) -> Twist | None:
        """Answer a pose.

        Args:
            stamp: [ns] time the pose belongs to.
            now: [s] time of arrival, on the clock of :meth:`on_tick`.
            pose: in the frame of the goals.
        """
        dt = 0.0 if self._stamp is None else min(max((stamp - self._stamp) * 1e-9, 0.0), _LONGEST_STEP)
        self._stamp = stamp
        self._heard = now
        if self.goal is None:
            return self._come_to_rest(dt)
        self.memory, command, self.report = step(self.memory, pose, self.goal, dt, self.config.controller)
        self.state = REACHED if self.memory.reached else DRIVING
        if self.memory.reached and not self._counted:
            self._counted = True
            self.goals_reached += 1
            if not self.config.hold_goal:
                self._go_idle(REACHED)
        return command

    def on_tick(self, now: float) -> Twist | None:
        """Watch for silence: zero while there is something to do but no pose came for ``pose_timeout``."""
        if self._heard is None or (self.goal is None and self._zeros_due == 0):
            return None
        # Time that runs backwards (a simulation started again) must not silence the watch for good.
        self._heard = min(self._heard, now)
        if now - self._heard <= self.config.pose_timeout:
            return None
        self.memory = self.memory._replace(v=0.0, omega=0.0, steps_within=0)
        if self.goal is None:
            self._zeros_due -= 1
        else:
            self.state = STALE
        return Twist(0.0, 0.0)

    def _go_idle(self, state: str) -> None:
        self.goal = None
        self.report = None
        self.state = state
        self._zeros_due = _STOP_REPEATS

    def _come_to_rest(self, dt: float) -> Twist | None:
        self.memory, command = stop_step(self.memory, dt, self.config.controller)
        if command != (0.0, 0.0):
            return command
        if self._zeros_due > 0:
            self._zeros_due -= 1
            return command
        return command if self.config.publish_when_idle else None
