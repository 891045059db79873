"""Nav2's actions, with the real interface and rclpy's ActionClient: results, feedback, preemption, cancelling."""

import itertools
import signal
import time

import graph
import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from nav_msgs.msg import Path
from robot import SIMULATED, distance, on_truth, pose_stamped, robot

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ros.goals.server import GoalServer
from diffbot_core.errors import BadMessageError

LAST, BESIDE, FAR = (4.0, 4.5, 0.5), (-2.5, 4.0, 0.0), (60.0, -60.0, 0.0)
PLANT = {"clock": "scaled", "real_time_factor": 5.0, "seed": 3}
# With the default pose_timeout, a controller that is held up on a busy machine would stop the robot at once.
CONTROLLER = {"linear.x.max_velocity": 1.3, "pose_timeout": 60.0, **SIMULATED}


def nav2_environment(folder, **changes):
    environment = graph.environment(**changes)
    environment["PYTHONPATH"] += f":{folder}"
    return environment


def test_a_goal_that_becomes_unusable_before_its_acceptance_ends_with_the_reason(nodes, action_peer, monkeypatch):
    # The first test of this file, because later a process serves the action, too.
    def refuse(*_arguments):
        raise BadMessageError("the transform is too old")

    monkeypatch.setattr(GoalServer, "accept", refuse)
    nodes.add(ControllerNode)
    client = action_peer(nodes.peer, "navigate_to_pose")
    handle = client.send(pose=pose_stamped(*FAR))
    assert handle.accepted
    status, result = client.result(handle)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.error_code != 0
    assert "the transform is too old" in result.error_msg


@pytest.fixture(scope="module")
def driven(nav2_folder):
    with on_truth(PLANT, CONTROLLER, env=nav2_environment(nav2_folder, DIFFBOT_EXECUTOR="events")) as running:
        yield running


def test_a_path_is_driven_through_its_poses_with_feedback(driven, action_peer):
    through = action_peer(driven.peer, "navigate_through_poses")
    handle = through.send(poses=[pose_stamped(*BESIDE), pose_stamped(*LAST)])
    assert handle.accepted
    status, result = through.result(handle)
    assert (status, result.error_code, result.error_msg) == (GoalStatus.STATUS_SUCCEEDED, 0, "")
    assert distance(driven.true_pose(), LAST) <= 0.4
    feedback = through.feedback
    # The result may arrive before the last feedback, which is sent twice a second on the last 6.5 m.
    driven.peer.spin_until(
        lambda: feedback and abs(feedback[-1].current_pose.pose.position.x - LAST[0]) < 4.0, what="the last feedback"
    )
    assert [one for one, _ in itertools.groupby(each.number_of_poses_remaining for each in feedback)] == [2, 1]
    assert feedback[-1].distance_remaining < 0.5 * feedback[0].distance_remaining
    times = [one.navigation_time.sec + 1e-9 * one.navigation_time.nanosec for one in feedback]
    assert times == sorted(times)
    assert times[-1] > 0.0
    assert feedback[-1].current_pose.header.frame_id == "map"
    assert not through.send().accepted, "an empty path"
    assert "navigate_through_poses: goal rejected: path is empty" in driven.processes["controller"].output


def test_a_path_is_followed_replaced_and_cancelled_with_the_feedback_and_the_error_codes_of_nav2(driven, action_peer):
    follow = action_peer(driven.peer, "follow_path")
    x, y, _ = driven.true_pose()
    down = [pose_stamped(x, y - 0.1 * i, 0.0, frame="") for i in range(21)]
    path = Path(header=pose_stamped(0, 0, 0).header, poses=down)
    handle = follow.send(path=path, controller_id="FollowPath")
    status, result = follow.result(handle)
    assert (status, result.error_code, result.error_msg) == (GoalStatus.STATUS_SUCCEEDED, 0, "")
    assert distance(driven.true_pose(), (x, y - 2.0)) <= 0.4
    feedback = follow.feedback
    assert feedback[0].distance_to_goal > feedback[-1].distance_to_goal
    assert 0.0 < max(one.speed for one in feedback) <= 1.3
    log = driven.processes["controller"].output
    assert "path of 21 goals: its orientations are equal and contradict its direction" in log
    assert "controller_id and goal_checker_id are ignored" in log
    assert not follow.send(path=Path(header=path.header)).accepted, "an empty path"
    far = Path(header=path.header, poses=[*down, pose_stamped(*FAR)])
    replaced, newer = follow.send(path=far), follow.send(path=far)
    status, result = follow.result(replaced)
    assert (status, result.error_code) == (GoalStatus.STATUS_ABORTED, result.UNKNOWN)
    assert result.error_msg == "replaced: by a newer goal (action)"
    answer = follow.cancel(newer)
    assert [bytes(info.goal_id.uuid) for info in answer.goals_canceling] == [bytes(newer.goal_id.uuid)]
    status, result = follow.result(newer)
    reason = "cancelled: by a client of the action follow_path"
    assert (status, result.error_msg) == (GoalStatus.STATUS_CANCELED, reason)
    assert not follow.cancel(newer).goals_canceling


def test_follow_path_alone_is_served_with_little_cpu_until_its_end_and_a_second_server_is_an_error(
    nav2_folder, action_peer
):
    """As beside Nav2's bt_navigator. A SingleThreadedExecutor could run a task of a waiting action without a pause."""
    options = {"env": nav2_environment(nav2_folder, DIFFBOT_EXECUTOR="single"), "namespace": "/below"}
    with robot(controller={"nav2_actions": "follow_path"}, only=("controller",), **options) as running:
        peer, controller = running.peer, running.processes["controller"]
        client = action_peer(peer, "follow_path")
        names = [name for name, _ in peer.node.get_topic_names_and_types()]
        assert not any(name.startswith("/below/navigate") for name in names)
        path = Path(header=pose_stamped(0, 0, 0).header, poses=[pose_stamped(*FAR)])
        handle = client.send(path=path)
        assert handle.accepted
        clock = (~controller.popen.pid << 3) | 2  # of another process, as glibc's clock_getcpuclockid names it
        began, used = time.monotonic(), time.clock_gettime(clock)
        peer.spin_for(1.0)
        assert (time.clock_gettime(clock) - used) / (time.monotonic() - began) < 0.6
        peer.publisher(GoalStatusArray, "follow_path/_action/status")
        controller.wait_for_output("2 publishers of /below/follow_path/_action/status, only one may serve follow_path")
        answer = handle.get_result_async()
        peer.spin_for(1.0)  # until the controller has received the request
        assert controller.stop(signal.SIGINT) == 0
        peer.spin_until(answer.done, what="the result")
        reason = "cancelled: by the deactivation of the controller"
        assert (answer.result().status, answer.result().result.error_msg) == (GoalStatus.STATUS_ABORTED, reason)
