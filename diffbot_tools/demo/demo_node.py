"""The node ``demo``: waits for the graph, starts the plant, sends the goals, prints its progress as JSON lines."""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_tools.demo.demo_node"))

import json
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool

from diffbot_control.ros.messages.conversions import goal_message
from diffbot_core.geometry import Pose
from diffbot_core.ros.node import LATCHED, QUEUE, DiffbotNode, run
from diffbot_core.units import NS_PER_S
from diffbot_tools.demo.mission import Mission
from diffbot_tools.demo.parameters import DemoNodeConfig

_PERIOD = 0.05
_RECORDER_PATIENCE = 10.0
"""[s] at the end, for a recorder that is held up to receive the goals; with the last node its messages are gone"""
_READY_TICKS = 10
"""Consecutive ticks with a ready graph: the two ends of a connection discover each other at different times."""


class DemoNode(DiffbotNode[DemoNodeConfig]):
    """Sends the goals, the first before the plant's first step: up to the second, a lock-step run is repeatable."""

    def __init__(self, **node_options: Any) -> None:
        """Create publisher, subscriptions and client, and wait for the graph."""
        super().__init__("demo", DemoNodeConfig, **node_options)
        config = self.config
        triples = zip(*[iter(config.goals)] * 3, strict=True)
        self.mission = Mission([Pose(*triple) for triple in triples], config.hold, config.goal_timeout)
        self._now = 0.0
        self._recorded: set[str] = set()
        self._controller_state = ""
        self._ekf_received = False
        self._ready_ticks = 0
        self._phase = "waiting for the graph"
        self._goals = self.create_publisher(PoseStamped, "goal_pose", QUEUE)
        self.subscribe(DiagnosticStatus, "recorder/status", self._on_recorder, LATCHED)
        self.subscribe(DiagnosticStatus, "controller/status", self._on_controller, LATCHED)
        self.subscribe(DiagnosticStatus, "ekf/status", self._on_ekf, LATCHED)
        self.subscribe(Float64MultiArray, "controller/navigation", self._on_navigation)
        self._pause = self.create_client(SetBool, "plant/pause")
        self._report_progress()
        self.create_timer(_PERIOD, self._on_tick, clock=self.steady_clock)

    def _on_recorder(self, message: DiagnosticStatus) -> None:
        self._recorded = set(_values(message).get("topics", "").split())

    def _on_ekf(self, _message: DiagnosticStatus) -> None:
        self._ekf_received = True

    def _on_controller(self, message: DiagnosticStatus) -> None:
        self._controller_state = message.message
        self.mission.on_goals_reached(int(_values(message).get("goals reached", "0")))

    def _on_navigation(self, message: Float64MultiArray) -> None:
        self._now, distance = message.data[0], message.data[1]
        if self.mission.on_navigation(self._now, distance):
            self._send_goal()
        if self.mission.done and self._phase == "driving":
            self._phase = "stopping"
            if self.config.pause_at_end:
                self._set_paused(True)
            else:
                self._end()

    def _on_tick(self) -> None:
        self._ready_ticks = self._ready_ticks + 1 if self._graph_is_ready() else 0
        if self._phase == "waiting for the graph" and self._ready_ticks >= _READY_TICKS:
            self._send_goal()
            self._phase = "waiting for the controller"
        elif self._phase == "waiting for the controller" and self._controller_state == "waiting for pose":
            self._set_paused(False)
            self._phase = "driving"
        self._report_progress()

    def _graph_is_ready(self) -> bool:
        required = {self.resolve_topic_name(topic) for topic in self.config.recorded_topics}
        # The recorder subscribes to goals as well as the controller.
        listeners = 1 + (self._goals.topic_name in required)
        return bool(
            required <= self._recorded
            and self._ekf_received
            and self._controller_state
            and self._goals.get_subscription_count() >= listeners
            and self._pause.service_is_ready()
        )

    def _send_goal(self) -> None:
        self._goals.publish(goal_message(self.mission.goal, self.config.map_frame, round(self._now * NS_PER_S)))

    def _set_paused(self, paused: bool) -> None:
        future = self._pause.call_async(SetBool.Request(data=paused))
        if paused:
            future.add_done_callback(lambda _: self._end())

    def _end(self) -> None:
        self._goals.wait_for_all_acked(Duration(seconds=_RECORDER_PATIENCE))
        self._phase = "done"
        self._report_progress()
        self.finish(2 if self.mission.gave_up else 0)

    def _report_progress(self) -> None:
        missing = sorted({self.resolve_topic_name(t) for t in self.config.recorded_topics} - self._recorded)
        line = {
            "phase": self._phase,
            "progress": self.mission.progress,
            "legs": [leg._asdict() for leg in self.mission.legs],
            "missing": missing,
        }
        print(json.dumps(line), flush=True)


def _values(message: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in message.values}


def main(args: list[str] | None = None) -> int:
    """Run the node; return 0 if all goals were reached, 2 after giving one up."""
    return run(DemoNode, args)
