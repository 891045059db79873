"""The node ``controller``: pose or odometry/filtered, and goal_pose, goal_update or path -> cmd_vel."""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_control.controller_node"))

import math
import time
from collections.abc import Mapping
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from diffbot_control.goals.dock_contact import DockContact
from diffbot_control.goals.driver import STOP
from diffbot_control.goals.goal_record import NOT_REACHED
from diffbot_control.goals.states import ACTIVE
from diffbot_control.goals.supervisor import Supervisor
from diffbot_control.ros.controller_publishers import STATE_LOG_PERIOD, ControllerPublishers
from diffbot_control.ros.controller_status import BEYOND_LIMITS, LEVELS
from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.goals.nav2_actions import serve_nav2_actions
from diffbot_control.ros.goals.server import GoalServer
from diffbot_control.ros.goals.updates import TOPIC as UPDATE_TOPIC
from diffbot_control.ros.goals.updates import WITHOUT_GOAL, GoalUpdates
from diffbot_control.ros.messages.conversions import goal_from, path_from, pose_from, poses_along
from diffbot_control.ros.messages.fields import stamp_ns
from diffbot_control.ros.messages.raw import read_path, read_pose
from diffbot_control.ros.parameters.controller import (
    CONTROLLER_PRESETS,
    ControllerNodeConfig,
    law_of,
    parameter_set_of,
)
from diffbot_control.ros.pose_watch import PoseWatch
from diffbot_control.ros.tf import transforms_of
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.ros.managed_node import ManagedNode
from diffbot_core.ros.node import run
from diffbot_core.ros.qos import sensor_qos
from diffbot_core.uncertainty import Uncertainty
from diffbot_core.units import NS_PER_S

_STATUS_PERIOD = 0.5
_HAS_POWER = {
    BatteryState.POWER_SUPPLY_STATUS_CHARGING: True,
    BatteryState.POWER_SUPPLY_STATUS_FULL: True,
    BatteryState.POWER_SUPPLY_STATUS_DISCHARGING: False,
    BatteryState.POWER_SUPPLY_STATUS_NOT_CHARGING: False,
}
"""States of a battery from which it follows if a charger supplies the robot."""
_MIN_WATCH_PERIOD = 1e-3
"""[s] a timer with a period of 0 would use a whole processor."""


class ControllerNode(ManagedNode[ControllerNodeConfig]):
    """Answers every pose with one command while a goal is driven to or held."""

    moves_the_robot = True

    def __init__(self, **node_options: Any) -> None:
        """Create the node, and with ``autostart`` start it."""
        super().__init__("controller", ControllerNodeConfig, CONTROLLER_PRESETS, **node_options)

    def configure(self) -> None:
        """Create publishers, subscriptions, the timer for missing poses and the service ~/cancel."""
        config = self.config
        self.law = law_of(config.law)
        self.supervisor = Supervisor(config.supervisor, self.law)
        self._robot_frame = robot_frame(config)
        self.outputs = ControllerPublishers(self)
        self._transforms = transforms_of(self, config.transform_tolerance)
        self._pose_watch = PoseWatch(self.clock_watch)
        self._newest_time = 0.0
        self._contact = DockContact()
        self.goals = GoalServer(self, self.supervisor, self._goals_of, self._now, self.cancel, self._publish_status)
        self._actions = serve_nav2_actions(self, self.goals)
        self.subscribe(PoseStamped, "goal_pose", lambda message: self.goals.singles.take(self._goals_of(message)[0]))
        self._updates = GoalUpdates(self, self.goals)
        self.subscribe(PoseStamped, UPDATE_TOPIC, self._on_goal_update, sensor_qos(config.reliable_inputs))
        self.subscribe(Path, "path", self._on_path, raw=True)
        if hasattr(self.supervisor.memory, "contact"):
            self.subscribe(Bool, "dock_contact", self._on_switch)
            self.subscribe(BatteryState, "battery_state", self._on_battery)
        self._pose_topic = "pose" if config.pose_source == "pose" else "odometry/filtered"
        self._receive_poses(self._pose_topic)
        self.publisher_watch.watch("cmd_vel", "drive the robot", config.commands.max_cmd_vel_publishers)
        self.publisher_watch.watch(self._pose_topic, "estimate the pose")
        self.create_service(Trigger, "~/cancel", self._on_cancel)
        self._watch = self.create_timer(self._watch_period(), self._on_tick, clock=self.steady_clock)
        self.create_timer(_STATUS_PERIOD, self._publish_status, clock=self.steady_clock)

    def activate(self) -> None:
        """Start without a goal and publish that."""
        self._start_anew()
        self._pose_watch.on_goal()
        # Even without a goal: the first message that a subscriber receives is then the past, and all others are new.
        self.goals.publish_changes(force=True)
        self._publish_status()

    def _start_anew(self) -> None:
        book = self.supervisor.goals
        self.supervisor = self.goals.supervisor = Supervisor(self.config.supervisor, self.law)
        # How earlier goals ended is still to be answered.
        self.supervisor.goals = book
        # A switch may report changes only.
        self.supervisor.on_contact(self._contact.touches)

    def deactivate(self) -> None:
        """Stop the robot and leave cmd_vel to others; the goal is cancelled."""
        # First, since the rest may fail, and before the publisher may be destroyed.
        self.outputs.deliver(STOP)
        self.goals.drop_pending()
        self.supervisor.on_stop()
        self._publish_status()
        self.goals.publish_changes()

    def halt(self) -> None:
        """Stop the robot and end the goal as not reached; it stands until the next one."""
        if not self.is_active:
            return
        self.outputs.send(STOP)  # first: what follows may fail, too
        has_goal = self.goals.paths.drop() or self.supervisor.state in ACTIVE
        reason = self.faults.newest
        self.supervisor.goals.close(NOT_REACHED, reason)
        # Where it has failed is unknown: nothing of it is used again.
        self._start_anew()
        if has_goal:
            self.supervisor.on_fault(reason)
        self._publish_status()
        self.goals.publish_changes(force=True)

    def cleanup(self) -> None:
        """Take the actions out of service."""
        if self._actions is not None:
            self._actions.destroy()

    def _receive_poses(self, topic: str) -> None:
        """Subscribe to the pose's topic."""
        qos = sensor_qos(self.config.reliable_inputs)
        if topic == "pose":
            self.subscribe(PoseWithCovarianceStamped, topic, lambda data: self._on_pose(read_pose(data)), qos, raw=True)
        else:
            self.subscribe(Odometry, topic, self._on_pose, qos)

    def parameter_set(
        self,
        config_type: type[ControllerNodeConfig],
        presets: Mapping[str, ControllerNodeConfig] | None,
        overrides: Mapping[str, Any],
    ) -> tuple[type[ControllerNodeConfig], Mapping[str, ControllerNodeConfig] | None]:
        """Return the parameters for the law among the overrides."""
        return parameter_set_of(overrides)

    def on_config(self, config: ControllerNodeConfig) -> None:
        """Use changed gains, limits and tolerances from the next pose on."""
        self.supervisor.config = config.supervisor
        self._watch.timer_period_ns = int(self._watch_period() * NS_PER_S)

    def health_level(self) -> tuple[int, str]:
        """Report the controller's state in /diagnostics."""
        level, text = super().health_level()
        problem = self._pose_watch.clock_problem(self.config) if self.is_configured else ""
        text = text if problem in text else f"{problem}; {text}"
        return max(level, LEVELS.get(self.supervisor.status, 0)), f"{self.supervisor.status}; {text}"

    def _watch_period(self) -> float:
        # A clock that stands still is noticed up to one period late, and so is the end of its timeout.
        return min(max(0.125 * self.config.supervisor.pose_timeout, _MIN_WATCH_PERIOD), 0.05)

    def _on_path(self, data: bytes) -> None:
        self._check_active()
        config = self.config
        self.goals.paths.start(poses_along(read_path(data), config.map_frame, self._transforms, config.max_path_poses))

    def _on_switch(self, message: Bool) -> None:
        self._contact.on_switch(message.data)
        self.supervisor.on_contact(self._contact.touches)

    def _on_battery(self, message: BatteryState) -> None:
        self._contact.on_charger(_HAS_POWER.get(message.power_supply_status))
        self.supervisor.on_contact(self._contact.touches)

    def _on_goal_update(self, message: PoseStamped) -> None:
        if self.supervisor.goals.present is None:
            self.health.counted[WITHOUT_GOAL] += 1
            return
        goal = goal_from(message, self.config.map_frame, self._transforms)
        self._updates.take(stamp_ns(message.header.stamp), goal)

    def _goals_of(self, message: PoseStamped | Path) -> list[Pose]:
        """Return the goals of a message in ``map_frame``.

        Raises:
            BadMessageError: if it cannot be used, or the node is inactive.
        """
        self._check_active()
        frame = self.config.map_frame
        if isinstance(message, Path):
            return path_from(message, frame, self._transforms, self.config.max_path_poses)
        return [goal_from(message, frame, self._transforms)]

    def _check_active(self) -> None:
        if not self.is_active:
            raise BadMessageError("the controller is inactive")
        self._pose_watch.on_goal()

    def _on_pose(self, message: PoseWithCovarianceStamped | Odometry) -> None:
        stamp, pose, uncertainty = pose_from(message, self.config.map_frame, self._robot_frame)
        self._answer(stamp, pose, self._fallback() if uncertainty is None else uncertainty)

    def take_pose(self, stamp: int, pose: Pose, uncertainty: Uncertainty) -> None:
        """Answer an estimate handed over in this process, as if it had come as a message.

        Args:
            stamp: [ns] time the pose belongs to.
            pose: in ``map_frame``.
            uncertainty: of the pose; it has to be known.
        """
        if self._answer(stamp, pose, uncertainty):
            self.health.accept(self._pose_topic, time.monotonic())

    def _answer(self, stamp: int, pose: Pose, uncertainty: Uncertainty) -> bool:
        """Answer a pose; return whether its stamp advanced, the only sign of life there is."""
        advances = self._pose_watch.on_pose(stamp)
        if not advances:
            self.health.counted[f"{self._pose_topic} without a later stamp"] += 1
        if not self.is_active:
            return advances
        if self._pose_watch.is_stale(self.config):
            self._on_tick()
            return advances
        steady = math.nan if self.clock_watch.is_simulated else time.monotonic()
        command = self.supervisor.on_pose(stamp, self._now(), pose, uncertainty, steady)
        if command is not None:
            self.outputs.send(command, stamp)
            self._report_limits()
        self.outputs.publish_navigation(stamp, self.supervisor)
        self._publish_changes()
        return advances

    def _now(self) -> float:
        """Return the node's time [s]; what came before the first message on /clock is counted as of that message."""
        before, self._newest_time = self._newest_time, self.clock_watch.now()
        if before <= 0.0 < self._newest_time:
            self.supervisor.count_time_from(self._newest_time)
        return self._newest_time

    def _report_limits(self) -> None:
        if self.supervisor.is_beyond_limits:
            self.health.counted["commands beyond lowered limits"] += 1
            self.get_logger().warning(BEYOND_LIMITS, throttle_duration_sec=STATE_LOG_PERIOD)

    def _fallback(self) -> Uncertainty:
        """Return the uncertainty of a pose without covariance; counted, and logged once."""
        note = f"{self._pose_topic} with the covariance of the parameters"
        self.health.counted[note] += 1
        fallback = self.config.pose_fallback
        if self.health.counted[note] == 1:
            self.get_logger().warning(
                f"{self._pose_topic}: covariance is all zero, i.e. unknown: assuming pose_sigma_xy = "
                f"{fallback.pose_sigma_xy:g} m, pose_sigma_yaw = {fallback.pose_sigma_yaw:g} rad "
                "(logged once; see /diagnostics)"
            )
        return fallback.uncertainty()

    def _on_tick(self) -> None:
        if not self.is_active:
            return
        watch = self._pose_watch
        command = self.supervisor.on_tick(
            self._now(),
            watch.silence(),
            watch.is_stale(self.config),
            watch.goal_age(self.supervisor.accepted),
        )
        if command is not None:
            self.outputs.send(command)
        self._publish_changes()

    def _on_cancel(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.cancel()
        response.message = "cancelled" if response.success else "there was no goal"
        return response

    def cancel(self) -> bool:
        """Drop the goal and start to come to rest; return whether there was one."""
        had_goal = self.goals.drop_pending() or self.supervisor.goal is not None
        command = self.supervisor.on_cancel()
        if command is not None:
            self.outputs.send(command)
        self._publish_status()
        self.goals.publish_changes(force=had_goal)
        return had_goal

    def _publish_changes(self) -> None:
        self.outputs.publish_status(self.supervisor, self.law, only_changes=True)
        self.goals.publish_changes()

    def _publish_status(self) -> None:
        self.outputs.publish_status(self.supervisor, self.law)


def main(args: list[str] | None = None) -> int:
    """Run the node; return the exit status of the process."""
    return run(ControllerNode, args, shared_memory=False)
