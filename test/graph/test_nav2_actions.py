"""Nav2's actions, with the real interface and rclpy's ActionClient: results, feedback, preemption, cancelling."""

import contextlib
import itertools
import time

import graph
import pytest
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Twist
from interfaces import nav2_environment, nav2_folder  # noqa: F401 - a fixture
from rclpy.action import ActionClient
from robot import DEEP, SIMULATED, Robot, distance, pose_stamped, twist

A_MAX = 0.5
NEAR, FAR = (-3.0, 4.5, 0.5), (60.0, -60.0, 0.0)
PLANT = {"clock": "scaled", "real_time_factor": 5.0, "seed": 3}
CONTROLLER = {"linear.x.max_acceleration": A_MAX, "angular.z.max_acceleration": 1.0, **SIMULATED}


class Client:
    """One action client of the test's node."""

    def __init__(self, robot, name):
        from nav2_msgs import action

        self.robot, self.peer = robot, robot.peer
        self.type = {"navigate_to_pose": action.NavigateToPose, "navigate_through_poses": action.NavigateThroughPoses}[
            name
        ]
        self.client = ActionClient(robot.peer.node, self.type, name)
        self.feedback = []
        self.peer.spin_until(self.client.server_is_ready, 15.0, f"the action {name}")

    def send(self, *goals, frame="map"):
        """Send a goal and return its handle."""
        poses = [pose_stamped(*goal, frame=frame) for goal in goals]
        goal = self.type.Goal()
        if hasattr(goal, "poses"):
            goal.poses = poses
        else:
            goal.pose = poses[0]
        self.feedback.clear()
        sent = self.client.send_goal_async(goal, lambda message: self.feedback.append(message.feedback))
        self.peer.spin_until(sent.done, 10.0, "the answer to a goal")
        return sent.result()

    def result(self, handle, timeout=40.0):
        """Return status and result of a goal."""
        future = handle.get_result_async()
        self.peer.spin_until(future.done, timeout, "the result")
        return future.result().status, future.result().result

    def cancel(self, handle):
        future = handle.cancel_goal_async()
        self.peer.spin_until(future.done, 10.0, "the answer to a cancellation")
        return future.result()


@pytest.fixture(scope="module", params=["events", "single"])
def driven(request, nav2_folder):  # noqa: F811
    """A robot whose controller serves the actions, on either executor."""
    with contextlib.ExitStack() as stack:
        peer = stack.enter_context(graph.peer())
        robot = Robot(stack, peer, "")
        robot.commands = peer.subscribe(Twist, "cmd_vel", DEEP)
        environment = nav2_environment(nav2_folder, DIFFBOT_EXECUTOR=request.param)
        for name, parameters in (("ekf", SIMULATED), ("controller", CONTROLLER), ("plant", PLANT)):
            robot.launch(name, parameters, env=environment)
        robot.wait_until_ready("ekf", "controller", "plant")
        yield robot


@pytest.fixture(scope="module")
def to_pose(driven):
    return Client(driven, "navigate_to_pose")


def test_a_goal_is_reached_with_feedback(driven, to_pose):
    handle = to_pose.send(NEAR)
    assert handle.accepted
    status, result = to_pose.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED
    assert (result.error_code, result.error_msg) == (0, "")
    assert distance(driven.true_pose(), NEAR) <= 0.4
    distances = [feedback.distance_remaining for feedback in to_pose.feedback]
    assert max(distances) > 0.5
    assert distances[-1] < 0.5 * distances[0]
    last = to_pose.feedback[-1]
    assert last.navigation_time.sec + last.navigation_time.nanosec > 0
    assert last.current_pose.header.frame_id == "map"
    assert abs(last.current_pose.pose.position.x - NEAR[0]) < 1.0


def test_a_newer_goal_aborts_the_older_with_its_reason(driven, to_pose):
    older = to_pose.send(FAR)
    newer = to_pose.send((-60.0, 60.0, 0.0))
    status, result = to_pose.result(older)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.error_code != 0
    assert result.error_msg == "replaced: by a newer goal (action)"
    driven.send_goal(*FAR)
    status, result = to_pose.result(newer)
    assert (status, result.error_msg) == (GoalStatus.STATUS_ABORTED, "replaced: by a newer goal (goal_pose)")


def test_cancelling_brakes_within_the_limits_and_ends_at_rest(driven, to_pose):
    handle = to_pose.send(FAR)
    driven.peer.spin_until(lambda: abs(twist(driven.commands[-1])[0]) > 0.3, 15.0, "motion")
    before = len(driven.commands)
    answer = to_pose.cancel(handle)
    assert [bytes(info.goal_id.uuid) for info in answer.goals_canceling] == [bytes(handle.goal_id.uuid)]
    status, result = to_pose.result(handle)
    assert (status, result.error_msg) == (GoalStatus.STATUS_CANCELED, "cancelled")
    driven.peer.spin_until(lambda: twist(driven.commands[-1]) == (0.0, 0.0), 5.0, "rest")
    speeds = [twist(command)[0] for command in driven.commands[before - 1 :]]
    # Steps of 0.1 s; the margin is for the rounding of stamps.
    changes = [abs(after - speed) for speed, after in itertools.pairwise(speeds)]
    assert max(changes) <= 0.1 * A_MAX * 1.001
    assert len([speed for speed in speeds if speed != 0.0]) >= 5
    again = to_pose.cancel(handle)
    assert not again.goals_canceling


def test_a_goal_in_another_frame_is_rejected_and_changes_nothing(driven, to_pose):
    driven.send_goal(*NEAR)
    assert not to_pose.send((0.0, 0.0, 0.0), frame="odom").accepted
    bad = to_pose.send((float("nan"), 0.0, 0.0))
    assert not bad.accepted
    assert graph.values(driven.controller_states[-1])["goal"].split()[:2] == ["-3", "4.5"]
    diagnosis = driven.diagnosis("controller")
    assert diagnosis["navigate_to_pose dropped: wrong frame_id"] == "1"


def test_a_goal_cancelled_by_the_service_is_aborted_as_cancelled(driven, to_pose):
    handle = to_pose.send(FAR)
    assert driven.cancel().success
    status, result = to_pose.result(handle)
    assert (status, result.error_msg) == (GoalStatus.STATUS_ABORTED, "cancelled")


def test_a_path_is_driven_through_its_poses(driven):
    through = Client(driven, "navigate_through_poses")
    handle = through.send((-2.5, 4.0, 0.0), NEAR)
    status, _ = through.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED
    assert through.feedback, "more than one pose takes a while"
    remaining = [feedback.number_of_poses_remaining for feedback in through.feedback]
    assert remaining[0] == 2
    assert remaining[-1] == 1
    assert not through.send().accepted, "an empty path"
    assert "navigate_through_poses: goal rejected: path is empty" in driven.processes["controller"].output


def test_a_waiting_action_takes_no_processor(driven, to_pose):
    """While a goal is driven to, the executor must not run a task of the action again and again."""
    handle = to_pose.send(FAR)
    pid = driven.processes["controller"].popen.pid
    clock = (~pid << 3) | 2  # of another process, as glibc's clock_getcpuclockid names it
    began, used = time.monotonic(), time.clock_gettime(clock)
    driven.peer.spin_for(1.0)
    share = (time.clock_gettime(clock) - used) / (time.monotonic() - began)
    to_pose.cancel(handle)
    to_pose.result(handle)
    assert share < 0.6
