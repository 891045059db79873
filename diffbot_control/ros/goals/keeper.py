"""The controller's present goal across a restart: kept in a file while it is driven to, resumed or answered for."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from diffbot_control.goals.goal_record import CANCELLED, GoalRequest
from diffbot_control.ros.goals.goal_file import BrokenGoalError, SavedGoal, encode_poses, load_goal, save_goal
from diffbot_control.ros.goals.server import GoalServer
from diffbot_core.errors import DiffbotError
from diffbot_core.files import file_path
from diffbot_core.ros.node import DiffbotNode

if TYPE_CHECKING:
    from diffbot_control.ros.parameters.controller import ControllerNodeConfig

RESTARTED = "the controller was restarted"
_MIN_PERIOD = 0.1
"""[s] between two writes: goals may come at any rate"""
_MAX_CLOCK_STEP = 1.0
"""[s] by which the system's clock may have been set back since the file was written"""


class GoalKeeper:
    """Keeps the file ``goal_file`` up to date; without that parameter it does nothing."""

    def __init__(self, node: DiffbotNode[ControllerNodeConfig], goals: GoalServer) -> None:
        """Note each end of a goal from now on.

        Raises:
            InvalidValueError: if ``goal_file`` cannot be the path of a file.
        """
        self._node, self._goals = node, goals
        self._path = file_path("goal_file", node.config.restart.goal_file)
        self._is_restored = False
        self._written: tuple[str, bool, int, int] | None = None
        """what the file holds: id, is_cancelling, waypoint, updates; None: there is no file"""
        self._last_write = 0.0
        self._encoded: tuple[tuple[str, int], list[str]] = ("", 0), []
        """id and updates of a goal, and all its poses as they are written"""
        goals.on_end.append(lambda _record: self.save())

    def restore(self) -> None:
        """Drive on to the goal of the file, or end it; the caller publishes that. Only the first call has an effect."""
        if self._path is None or self._is_restored:
            return
        self._is_restored = True
        config, logger = self._node.config, self._node.get_logger()
        try:
            saved = load_goal(self._path, config.max_path_poses)
            age = 0.0 if saved is None else time.time() - self._path.stat().st_mtime
        except BrokenGoalError as error:
            logger.warning(f"goal not restored: {error}; {_put_aside(self._path)}")
            return
        except (DiffbotError, OSError) as error:
            logger.warning(f"goal not restored: {error}")
            return
        if saved is None:
            return
        self._written = saved.id, saved.is_cancelling, saved.waypoint, 0
        obstacle = ""
        if saved.frame != config.map_frame:
            obstacle = f", with another map_frame than {saved.frame}"
        elif not -_MAX_CLOCK_STEP <= age <= config.restart.resume_timeout:
            obstacle = f", and was last alive {age:.0f} s before"
        is_resumed = config.restart.resume_goal and not obstacle
        self._take(saved, RESTARTED + (obstacle if config.restart.resume_goal else ""), is_resumed)

    def _take(self, saved: SavedGoal, reason: str, is_resumed: bool) -> None:
        """Give the goal to the supervisor, and end it there unless it is resumed."""
        supervisor, request = self._goals.supervisor, GoalRequest(saved.id, saved.source, self._node.clock_watch.now())
        if not saved.poses:  # it was being cancelled
            supervisor.goals.accept(request)
            supervisor.goals.close(CANCELLED)
        elif saved.waypoints:
            supervisor.on_path(saved.poses, request, saved.waypoint, saved.waypoints)
        else:
            supervisor.on_goal(saved.poses[0], request)
        if not is_resumed:
            supervisor.give_up(reason)
        outcome = "has ended" if supervisor.goals.present is None else "is driven to again"
        self._node.get_logger().warning(f"{reason}: goal {saved.id} {outcome}")

    def save(self) -> None:
        """Write the present goal if the file holds another state; otherwise renew the time of the file."""
        if self._path is None or not self._is_restored:
            return
        try:
            self._update(self._path)
        except FileNotFoundError:
            self._written = None  # deleted by someone: written again by the next call
        except OSError as error:
            text = f"cannot write goal_file: {error.strerror or error}"
            self._node.get_logger().error(text, throttle_duration_sec=60.0)

    def _update(self, path: Path) -> None:
        supervisor, now = self._goals.supervisor, time.monotonic()
        present, poses = supervisor.goals.present, supervisor.goals_ahead
        if present is None or not present.request.id:
            self._delete(path)
            return
        state = present.request.id, present.is_cancelling, supervisor.waypoint, supervisor.updates
        if state == self._written:
            os.utime(path)
        elif now - self._last_write >= _MIN_PERIOD:
            if self._encoded[0] != (state[0], state[3]):
                self._encoded = (state[0], state[3]), encode_poses(poses)
            encoded = self._encoded[1]
            goal = SavedGoal(
                present.request.id,
                present.request.source,
                self._node.config.map_frame,
                poses,
                supervisor.waypoint,
                supervisor.waypoints,
                present.is_cancelling,
            )
            save_goal(path, goal, encoded[len(encoded) - len(poses) :])
            self._written, self._last_write = state, now
        elif self._written is not None and self._written[:2] != state[:2]:
            # The file must not name a goal that has ended, not even until the next call.
            self._delete(path)

    def _delete(self, path: Path) -> None:
        if self._written is not None:
            self._written = None
            path.unlink(missing_ok=True)


def _put_aside(path: Path) -> str:
    """Rename a file that is no goal, which the next one would replace; return what was done."""
    kept = path.with_name(f"{path.name}.bad")
    try:
        path.replace(kept)
    except OSError as error:
        return f"it cannot be renamed: {error.strerror or error}"
    return f"the file is kept as {kept.name}"
