"""The controller of the dock takes over from the controller in map, without a graph."""

import math
from types import SimpleNamespace

from diffbot_control.docking_node import DockControllerNode
from diffbot_control.goals.supervisor import Supervisor, SupervisorConfig
from diffbot_core.geometry import Pose


def test_a_goal_that_is_held_in_map_is_cancelled_as_soon_as_the_service_is_discovered():
    dock, found, calls = object.__new__(DockControllerNode), [], []
    dock.supervisor, dock._ekf = Supervisor(SupervisorConfig()), SimpleNamespace(is_configured=False)
    dock._accepted, dock._goal_time, dock._in_map, dock._before, dock._must_cancel = 0, -math.inf, None, None, False
    dock._cancel_in_map = SimpleNamespace(service_is_ready=lambda: bool(found), call_async=calls.append)
    dock.supervisor.on_goal(Pose(0.0, 0.0, 0.0))
    dock._check_goals()
    assert calls == []
    found.append("controller/cancel")
    for _ in range(2):
        dock._check_goals()
    assert len(calls) == 1
