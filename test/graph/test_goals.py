"""Goals and their ends by the command, the Navigator and the topics, with a robot in another process."""

import re
import signal
import time

import graph
import pytest
from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from nav_msgs.msg import Path
from robot import SIMULATED, distance, planar, pose_stamped, robot, stamped_goal, twist

from diffbot_control.ros.navigator import Navigator, TaskResult
from diffbot_tools import cli

NEAR, BESIDE, FAR = (-3.0, -4.5, 0.5), (-1.0, -4.0, 0.0), (600.0, -600.0, 0.0)
LAST = (-9.0, -4.5, 0.5)
"""So far from the previous goal that the status, which is published twice a second, reports the drive to this goal."""
PLANT = {"clock": "scaled", "real_time_factor": 5.0, "seed": 3}
UNKNOWN = "frame_of_nobody"
"""A frame without a transform, with tf2_ros and without."""


@pytest.fixture(scope="module")
def driven():
    with robot(PLANT, SIMULATED, SIMULATED, only=("robot", "plant"), joined=True) as one:
        one.peer.spin_until(lambda: one.truths and one.poses, what="the first poses")
        yield one


@pytest.fixture(autouse=True)
def _without_a_goal(driven):
    driven.cancel()
    driven.peer.spin_until(lambda: not driven.goal(), what="no goal")


@pytest.fixture(scope="module")
def navigator():
    one = Navigator.in_own_context()
    assert one.waitUntilReady(graph.PATIENCE)
    yield one
    one.close()


def cancel_goal(driven, goal_id="0" * 32, sec=0):
    request = CancelGoal.Request()
    request.goal_info.goal_id.uuid = list(bytes.fromhex(goal_id))
    request.goal_info.stamp.sec = sec
    return driven.peer.call(CancelGoal, "controller/cancel_goal", request)


def test_a_command_that_is_interrupted_cancels_its_goal(driven):
    with graph.diffbot("goal", *map(str, FAR)) as command:
        driven.peer.spin_until(lambda: driven.goal() == FAR, what="the goal")
        assert command.stop(signal.SIGINT) == 130
        assert "interrupted: goal cancelled\n" in command.output
    driven.wait_for_state("idle")


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (("--no-wait",), 0, "goal [0-9a-f]{32} accepted\n"),
        (("--timeout", "5"), 8, "not reached within --timeout 5 s: goal cancelled\n"),
        (("--frame", UNKNOWN), 1, f"diffbot: goal refused: .*{UNKNOWN}.*\n"),
        (("--controller", "pilot", "--timeout", "1"), 1, "diffbot: no answer on /pilot/goal_status: does .*\n"),
    ],
)
def test_the_command_reports_the_end_in_one_line(driven, arguments, status, text, kept_signal_handlers, capfd):
    assert cli.main(["goal", *map(str, FAR), *arguments]) == status
    output, errors = capfd.readouterr()
    # On a busy machine the command waits for the controller; rcl warns if the node of the previous case still exists.
    errors = re.sub(r"waiting for the controller .*\n(  .*\n)*|\[WARN\] .* \[rcl\.logging_rosout\]: .*\n", "", errors)
    assert re.fullmatch(text, output + errors)


def test_a_command_that_waits_for_a_controller_names_the_present_controllers_and_can_be_interrupted(driven):
    with graph.diffbot("goal", *map(str, FAR), "--controller", "pilot") as interrupted:
        interrupted.wait_for_output("waiting for the controller /pilot on ROS_DOMAIN_ID ")
        interrupted.wait_for_output("  /controller is running: diffbot goal X Y YAW\n")
        assert interrupted.stop(signal.SIGINT) == 130
        assert interrupted.output.endswith("interrupted: no goal was sent\n")


def test_the_navigator_reaches_goals_with_feedback(driven, navigator):
    assert navigator.goThroughPoses([pose_stamped(*BESIDE), pose_stamped(*LAST)])
    seen = set()
    while not navigator.isTaskComplete():
        if (feedback := navigator.getFeedback()) is not None:
            seen.add(feedback.number_of_poses_remaining)
            assert feedback.current_pose.header.frame_id == "map"
            here = planar(feedback.current_pose.pose)
            left = distance(here, LAST)
            if feedback.number_of_poses_remaining == 2:
                left = distance(here, BESIDE) + distance(BESIDE, LAST)
            assert feedback.distance_remaining == pytest.approx(left, abs=1e-3)
    assert (navigator.getResult(), navigator.getReason()) == (TaskResult.SUCCEEDED, "reached")
    assert seen >= {2, 1}


def test_the_navigator_follows_waypoints_in_their_order_and_a_path(driven, navigator):
    waypoints = [pose_stamped(*BESIDE), pose_stamped(BESIDE[0], BESIDE[1], 2.0), pose_stamped(*NEAR)]
    assert navigator.followWaypoints(waypoints)
    seen = []
    while not navigator.isTaskComplete(task="newest"):
        if (feedback := navigator.getFeedback(task="newest")) is not None:
            seen.append(feedback.current_waypoint)
    assert navigator.getResult(task="newest") == TaskResult.SUCCEEDED
    assert seen == sorted(seen)
    assert {0, 2} <= set(seen)
    assert distance(driven.true_pose(), NEAR) < 0.15
    poses = [pose_stamped(NEAR[0], NEAR[1] + 0.2 * i, 0.0, frame="") for i in range(6)]
    assert navigator.followPath(Path(header=pose_stamped(0, 0, 0).header, poses=poses))
    while not navigator.isTaskComplete():
        pass
    assert navigator.getResult() == TaskResult.SUCCEEDED
    assert distance(driven.true_pose(), (NEAR[0], NEAR[1] + 1.0)) < 0.15
    assert not navigator.followWaypoints([])
    assert not navigator.followPath(Path())


def test_the_navigator_cancels_tasks_replaces_waypoints_and_is_refused(driven, navigator):
    assert navigator.followWaypoints([pose_stamped(*FAR), pose_stamped(*NEAR)])
    assert not navigator.isTaskComplete()
    assert navigator.getResult() == TaskResult.UNKNOWN
    assert not navigator.goToPose(pose_stamped(0, 0, 0, frame=UNKNOWN))
    assert not navigator.goThroughPoses([])
    assert not navigator.isTaskComplete(), "a refused goal changes nothing"
    assert navigator.cancelTask()
    assert navigator.isTaskComplete()
    assert navigator.getResult() == TaskResult.CANCELED
    assert navigator.followWaypoints([pose_stamped(*FAR), pose_stamped(*NEAR)])
    driven.catch_up()
    assert navigator.goToPose(pose_stamped(*planar(driven.poses[-1].pose.pose)))
    while not navigator.isTaskComplete():
        pass
    assert navigator.getResult() == TaskResult.SUCCEEDED
    # A refused goal does not drop the waypoints, and a refused waypoint ends the task.
    elsewhere = pose_stamped(0, 0, 0, frame=UNKNOWN)
    assert navigator.followWaypoints([pose_stamped(*NEAR), elsewhere, pose_stamped(*FAR)])
    assert not navigator.goToPose(elsewhere)
    while not navigator.isTaskComplete():
        pass
    assert (navigator.getResult(), navigator.getReason()) == (TaskResult.FAILED, "refused: waypoint 1, see the log")
    assert navigator.isTaskComplete()


def test_the_navigator_sets_the_initial_pose(driven, navigator):
    x, y, yaw = driven.true_pose()
    for pose in (pose_stamped(x + 3.0, y, yaw), pose_stamped(x, y, yaw)):
        assert navigator.setInitialPose(pose, sigma_xy=0.01, timeout=graph.PATIENCE)


def test_a_repeated_message_is_the_same_goal_even_after_the_end_of_the_goal(driven):
    at = time.time_ns()
    goal_id = driven.send_stamped(FAR, at=at)
    driven.goals.publish(stamped_goal(FAR, at=at)[1])
    newer = driven.send_stamped(NEAR)
    assert driven.ends()[goal_id] == ("replaced", "by a newer goal (goal_pose)")
    driven.goals.publish(stamped_goal(FAR, at=at)[1])
    assert driven.wait_for_end(newer) == ("reached", ""), "the older goal was not started again"
    assert driven.accepted()[goal_id] == GoalStatus.STATUS_ABORTED
    assert int(driven.diagnosis("controller")["goals that are known already"]) >= 2
    # Without a stamp, each message is a new goal.
    before = set(driven.accepted())
    driven.send_goal(*FAR)
    driven.send_goal(*FAR)
    driven.peer.spin_until(lambda: len(set(driven.accepted()) - before) == 2, what="two goals")


def test_a_goal_that_cannot_be_used_is_refused_with_the_reason_and_changes_nothing(driven):
    present = driven.send_stamped(FAR)
    for poses, frame, reason in (
        ([(float("nan"), 0.0, 0.0)], "map", "position not finite: nan"),
        ([FAR], "", "wrong frame_id: '', not 'map'"),
        ([NEAR] * 2001, "map", "path too long: 2001 poses, at most 2000"),
    ):
        refused = driven.send_stamped(*poses, frame=frame)
        assert driven.ends()[refused] == ("refused", reason)
        assert refused not in driven.accepted()
    assert driven.accepted()[present] == GoalStatus.STATUS_EXECUTING
    assert driven.goal() == FAR


def test_cancel_goal_follows_action_msgs(driven):
    goal_id = driven.send_stamped(FAR)
    response = CancelGoal.Response
    assert cancel_goal(driven, "1" * 32).return_code == response.ERROR_UNKNOWN_GOAL_ID
    assert cancel_goal(driven, sec=1).return_code == response.ERROR_REJECTED, "no goal is that old"
    assert driven.accepted()[goal_id] == GoalStatus.STATUS_EXECUTING
    answer = cancel_goal(driven, goal_id)
    assert answer.return_code == response.ERROR_NONE
    assert [bytes(info.goal_id.uuid).hex() for info in answer.goals_canceling] == [goal_id]
    end, reason = driven.wait_for_end(goal_id)
    assert end == "cancelled"
    assert re.fullmatch(r"by a call of /controller/cancel_goal from (/\w+ or )*(/peer|an unknown node)", reason)
    assert cancel_goal(driven, goal_id).return_code == response.ERROR_GOAL_TERMINATED
    driven.send_stamped(FAR)
    assert len(cancel_goal(driven).goals_canceling) == 1, "all"
    driven.peer.spin_until(lambda: not driven.goal(), what="rest")
    assert cancel_goal(driven).return_code == response.ERROR_REJECTED
    goal_id = driven.send_stamped(FAR)
    driven.cancel()
    assert driven.wait_for_end(goal_id) == ("cancelled", "by a call of /controller/cancel from /peer")
    driven.send_stamped(FAR)
    assert len(cancel_goal(driven, sec=2**31 - 1).goals_canceling) == 1, "all until then"
    driven.peer.spin_until(lambda: driven.commands and twist(driven.commands[-1]) == (0.0, 0.0), what="rest")


def test_each_goal_of_a_flood_is_answered_and_the_robot_drives_to_the_newest(driven):
    sent = [stamped_goal((50.0 + number, 0.0, 0.0)) for number in range(8)]  # fewer than the queues of the topic hold
    for _, message in sent:
        driven.goals.publish(message)
    *older, newest = (goal_id for goal_id, _ in sent)
    driven.peer.spin_until(lambda: newest in driven.accepted(), what="the newest goal")
    ends = {one.name: one.message for message in driven.goal_results for one in message.status}
    assert {ends.get(goal_id) for goal_id in older} == {"replaced"}
    assert driven.accepted()[newest] == GoalStatus.STATUS_EXECUTING
