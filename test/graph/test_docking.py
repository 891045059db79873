"""Docking over DDS in processes of its own: contact, undocking, another dock, and who may drive."""

from contextlib import ExitStack

import docks
import pytest
import rclpy
from graph import private_domain
from robot import pose_stamped

from diffbot_control.ros.navigator import TaskResult
from diffbot_core.geometry import Pose, out_of_frame

pytestmark = pytest.mark.graph


@pytest.fixture(scope="module")
def scene():
    """The nodes, and a navigator."""
    with private_domain(), ExitStack() as stack:
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        yield stack.enter_context(docks.Scene(seed=11))


@pytest.mark.parametrize("fault", docks.FAULTS)
def test_the_robot_meets_its_dock_or_none_and_is_answered(scene, fault):
    done = scene.run(fault)
    assert done.end, "no answer"
    assert not done.is_beside, done
    if fault in docks.HARMLESS:
        assert done.end == "reached", done
        assert done.contact is not None
        assert done.undocked
    else:
        assert done.end.startswith(("not reached: ", "pose lost: ")), done


def test_a_goal_in_map_lets_go_of_the_dock_and_a_docking_of_the_goal_in_map(scene):
    navigator = scene.navigator
    goal = pose_stamped(*out_of_frame(Pose(-1.5, 0.0, 0.0), docks.DOCK))
    assert navigator.goToPose(goal)
    first = navigator.task
    assert navigator.spin_until(lambda: first.feedback is not None, 30.0)
    assert navigator.dock()
    assert navigator.wait_for_end(60.0)
    assert first.end == "cancelled"
    docking = navigator._docking
    assert navigator.goToPose(goal)
    assert docking.wait_for_end(60.0)
    assert docking.task.end == "cancelled", docking.task.reason
    assert scene.wait() == "reached"
    assert navigator.getResult() == TaskResult.SUCCEEDED
