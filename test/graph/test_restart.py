"""A controller that is suspended or killed during a goal: its clients report the goal as lost and can send it again."""

import signal
import time
from contextlib import closing
from types import SimpleNamespace

import graph
from diagnostic_msgs.msg import DiagnosticStatus
from robot import ON_TRUTH, TRUE_POSES, distance, pose_stamped, robot

from diffbot_control import controller_node
from diffbot_control.controller_node import ControllerNode
from diffbot_control.ros.goals import client
from diffbot_control.ros.goals.client import LOST, GoalClient, GoalTask
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import CERTAIN

START, GOAL = Pose(-4.0, 0.2, 0.0), Pose(1.0, 0.2, 0.0)
PLANT = {"initial_pose.x": START.x, "initial_pose.y": START.y, "initial_pose.yaw": START.theta}


def test_a_goal_is_lost_for_its_clients_if_the_controller_is_suspended_or_killed_and_can_be_sent_again():
    with (
        closing(GoalClient.in_own_context()) as waiting,
        closing(GoalClient.in_own_context(node_name="patient", restart_timeout=graph.PATIENCE)) as patient,
        robot(PLANT, only=("plant",)) as running,
    ):
        controller = running.launch("controller", ON_TRUTH, TRUE_POSES)
        running.wait_until_ready("controller")

        suspended = waiting.send_goal([GOAL])
        controller.send(signal.SIGSTOP)
        try:
            assert waiting.wait_for_end(graph.PATIENCE)
        finally:
            controller.send(signal.SIGCONT)
        assert (suspended.end, suspended.reason) == (LOST, "the controller is gone")
        end, reason = running.wait_for_end(suspended.id)
        assert end == "not reached"
        assert reason.startswith("the controller was suspended for ")

        killed = waiting.send_goal([GOAL])
        patient.task = GoalTask(killed.id)
        assert patient.spin_until(lambda: patient.task.is_accepted, graph.PATIENCE)
        running.peer.spin_until(
            lambda: running.truths and running.truths[-1].twist.twist.linear.x > 0.1, what="a driving robot"
        )
        controller.stop(signal.SIGKILL)
        assert waiting.wait_for_end(graph.PATIENCE)
        assert (killed.end, killed.reason) == (LOST, "the controller is gone")
        running.catch_up()  # the last statuses of the killed controller are received before the list is cleared
        running.peer.spin_until(lambda: running.truths[-1].twist.twist.linear.x == 0.0, what="standstill")
        assert not patient.task.end
        running.controller_states.clear()
        running.launch("controller", ON_TRUTH, TRUE_POSES)
        running.wait_until_ready("controller")
        assert patient.wait_for_end(graph.PATIENCE)
        assert (patient.task.end, patient.task.reason) == (LOST, "the controller was restarted")
        running.wait_for_state("idle")

        again = waiting.send_goal([GOAL])
        assert waiting.wait_for_end(graph.PATIENCE)
        assert (again.end, again.reason) == ("reached", "")
        assert distance(running.true_pose(), GOAL) < 0.4


def test_a_suspension_right_after_the_activation_ends_the_goal_before_the_first_pose_is_used(nodes, monkeypatch):
    node = nodes.add(ControllerNode)
    node.goals.accept(pose_stamped(1.0, 0.0, 0.0), "action", "1" * 32)
    resumed = time.monotonic() + 2.5
    monkeypatch.setattr(controller_node, "time", SimpleNamespace(monotonic=lambda: resumed))
    node.take_pose(1, START, CERTAIN)
    (ended,) = node.supervisor.goals.ended
    assert ended.end == "not reached"
    assert ended.reason == "the controller was suspended for 2.5 s"


def test_a_lease_that_ended_is_ignored_while_messages_arrive(monkeypatch):
    """On a busy machine, DDS may report the end of a lease but not its renewal."""
    now = [time.monotonic()]
    with closing(GoalClient.in_own_context(restart_timeout=2.0)) as goals:
        monkeypatch.setattr(client, "time", SimpleNamespace(monotonic=lambda: now[0]))
        goals._on_liveliness(SimpleNamespace(alive_count=0))
        for _ in range(40):
            now[0] += 0.25
            goals._on_status(DiagnosticStatus())
            assert not goals._is_gone()
        silent = 0.0
        while not goals._is_gone():
            now[0], silent = now[0] + 0.25, silent + 0.25
        assert silent == 3.0  # restart_timeout and DELAY
