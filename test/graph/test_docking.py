"""Docking over DDS in processes of its own: contact, undocking, another dock, and who may drive."""

import signal
from contextlib import ExitStack

import docks
import graph
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from repeated import tried
from robot import LATCHED, pose_stamped

from diffbot_control.goals.record import RESTART_TIMEOUT
from diffbot_control.ros.goals.client import LOST, GoalClient, GoalTask
from diffbot_control.ros.navigator import TaskResult
from diffbot_core.geometry import Pose, out_of_frame

SLOW = dict.fromkeys((docks.FROZEN, docks.RELOCATED), pytest.mark.slow)
"""Faults that the tests of the law and of the sensors try in every run."""


@pytest.fixture(scope="module")
def scene():
    """The nodes, and a navigator."""
    with graph.private_domain(), ExitStack() as stack:
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        running = stack.enter_context(docks.Scene(seed=11))
        running.statuses = []
        running.navigator.create_subscription(DiagnosticStatus, "controller/status", running.statuses.append, LATCHED)
        yield running


def wait_until_released(scene):
    """Wait until the controller in map holds no pose: a docking makes it let go, of a goal that crosses that, too."""
    assert scene.navigator.spin_until(lambda: scene.statuses and scene.statuses[-1].message == "idle", 30.0)


def go_to(scene, x):
    """Send a goal before the dock."""
    assert scene.navigator.goToPose(pose_stamped(*out_of_frame(Pose(x, 0.0, 0.0), docks.DOCK)))


@tried(10)
@pytest.mark.parametrize("fault", [pytest.param(one, marks=SLOW.get(one, ())) for one in docks.FAULTS])
def test_the_robot_meets_its_dock_or_none_and_is_answered(scene, fault, trials):
    for _ in trials:
        done = scene.run(fault)
        assert done.end, "no answer"
        assert not done.is_beside, done
        if fault in docks.HARMLESS:
            assert done.end == done.undocking == "reached", done
            assert done.contact is not None
        else:
            assert done.end.startswith(("not reached: ", "pose lost: ")), done


def test_a_goal_in_map_lets_go_of_the_dock_and_a_docking_of_the_goal_in_map(scene):
    navigator = scene.navigator
    go_to(scene, -1.5)
    assert scene.wait() == "reached"
    assert navigator.undock()  # now the clients for docking have found their controller, and that sees its dock
    assert scene.wait() == "reached"
    wait_until_released(scene)
    go_to(scene, -100.0)  # so far that the robot does not arrive before the docking begins, on a busy machine either
    drive = navigator.task
    assert navigator.spin_until(lambda: drive.feedback is not None, 30.0)
    assert navigator.dock()
    assert navigator.wait_for_end(60.0)
    assert drive.text == "cancelled: by a call of /controller/cancel from /dock_controller"
    docking = navigator._docking
    go_to(scene, -1.5)
    assert docking.wait_for_end(60.0)
    assert docking.task.text == "cancelled: by a new goal of the controller in map"
    assert scene.wait() == "reached"
    assert navigator.getResult() == TaskResult.SUCCEEDED


def test_a_docking_waits_as_long_for_its_controller_as_the_navigator_was_told(scene):
    navigator = scene.navigator
    go_to(scene, -1.5)
    assert scene.wait() == "reached"
    assert navigator.dock()
    docking = navigator._docking
    impatient = GoalClient(
        "impatient", controller="dock_controller", prefix="dock/", restart_timeout=2.0 * RESTART_TIMEOUT
    )
    impatient.task = GoalTask(docking.task.id)
    held_up = scene.processes["docking"].popen
    held_up.send_signal(signal.SIGSTOP)
    try:
        graph.wait_for(lambda: navigator.isTaskComplete() or impatient.wait_for_end(0.1), what="an end")
    finally:
        held_up.send_signal(signal.SIGCONT)
        impatient.close(shut_down=False)
    assert impatient.task.end == LOST
    assert scene.wait()
    assert docking.task.end != LOST
