"""Goals with answers: the command, the Navigator and the bare services, with a robot in another process."""

import re
import signal

import graph
import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.srv import SetParametersAtomically
from robot import LATCHED, SIMULATED, distance, initialpose, planar, pose_stamped, robot, twist

from diffbot_control.ros.goals.request import goal_request, new_goal_id
from diffbot_control.ros.navigator import Navigator, TaskResult
from diffbot_core.geometry import Pose
from diffbot_tools import cli

NEAR, BESIDE, FAR = (-3.0, -4.5, 0.5), (-1.0, -4.0, 0.0), (600.0, -600.0, 0.0)
LAST = (-9.0, -4.5, 0.5)
"""So far from the goal before it that the status, which comes twice a second, is about the way to it."""
PLANT = {"clock": "scaled", "real_time_factor": 5.0, "seed": 3}
UNKNOWN = "frame_of_nobody"
"""A frame to which no transform leads, with tf2_ros and without."""


@pytest.fixture(scope="module")
def driven():
    with robot(PLANT, SIMULATED, SIMULATED, only=("robot", "plant"), joined=True) as one:
        one.peer.spin_until(lambda: one.truths and one.poses, what="the first poses")
        yield one


@pytest.fixture(autouse=True)
def _without_a_goal(driven):
    """No goal of the test before is under way."""
    driven.cancel()
    driven.peer.spin_until(lambda: not goal_of(driven), what="no goal")


@pytest.fixture(scope="module")
def navigator():
    one = Navigator.in_own_context()
    assert one.waitUntilReady(graph.PATIENCE)
    yield one
    one.close()


def goal_of(driven):
    return graph.values(driven.controller_states[-1]).get("goal", "") if driven.controller_states else ""


def send(driven, goal_id, *poses):
    """Call the service ~/send_goal and return its result."""
    request = goal_request(goal_id, [Pose(*pose) for pose in poses], "map")
    return driven.peer.call(SetParametersAtomically, "controller/send_goal", request).result


def cancel_goal(driven, goal_id="0" * 32, sec=0):
    request = CancelGoal.Request()
    request.goal_info.goal_id.uuid = list(bytes.fromhex(goal_id))
    request.goal_info.stamp.sec = sec
    return driven.peer.call(CancelGoal, "controller/cancel_goal", request)


def test_a_command_that_is_interrupted_cancels_its_goal(driven):
    with graph.diffbot("goal", *map(str, FAR)) as command:
        driven.peer.spin_until(lambda: "600 -600 0" in goal_of(driven), what="the goal")
        assert command.stop(signal.SIGINT) == 130
        assert "interrupted: goal cancelled\n" in command.output
    driven.wait_for_state("idle")


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (("--no-wait",), 0, "goal [0-9a-f]{32} accepted\n"),
        (("--timeout", "10"), 8, "not reached within --timeout 10 s: goal cancelled\n"),
        (("--frame", UNKNOWN), 1, f"diffbot: goal refused: .*{UNKNOWN}.*\n"),
        (("--controller", "pilot", "--timeout", "1"), 1, "diffbot: no answer from /pilot/send_goal: does .*\n"),
    ],
)
def test_the_command_reports_the_end_in_one_line(driven, arguments, status, text, kept_signal_handlers, capfd):
    assert cli.main(["goal", *map(str, FAR), *arguments]) == status
    written, said = capfd.readouterr()
    # On a busy machine the controller may have to be waited for; rcl warns if the node of the case before still exists.
    said = re.sub(r"waiting for the controller .*\n(  .*\n)*|\[WARN\] .* \[rcl\.logging_rosout\]: .*\n", "", said)
    assert re.fullmatch(text, written + said)


def test_a_command_that_waits_for_a_controller_names_those_that_it_sees_and_can_be_interrupted(driven):
    with graph.diffbot("goal", *map(str, FAR), "--controller", "pilot") as interrupted:
        interrupted.wait_for_output("waiting for the controller /pilot on ROS_DOMAIN_ID ")
        interrupted.wait_for_output("  there is /controller: diffbot goal X Y YAW\n")
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


def test_the_navigator_cancels_is_refused_and_sets_the_initial_pose(driven, navigator):
    assert navigator.goToPose(pose_stamped(*FAR))
    assert not navigator.isTaskComplete()
    assert navigator.getResult() == TaskResult.UNKNOWN
    assert not navigator.goToPose(pose_stamped(0, 0, 0, frame=UNKNOWN))
    assert not navigator.goThroughPoses([])
    assert not navigator.isTaskComplete(), "a refused goal changes nothing"
    assert navigator.cancelTask()
    assert navigator.isTaskComplete()
    assert navigator.getResult() == TaskResult.CANCELED
    here = driven.true_pose()
    moved = initialpose(here[0] + 3.0, here[1], here[2])
    wanted = PoseStamped(header=moved.header, pose=moved.pose.pose)
    assert navigator.setInitialPose(wanted, sigma_xy=0.01, timeout=graph.PATIENCE)
    assert navigator.setInitialPose(pose_stamped(*here), sigma_xy=0.01, timeout=graph.PATIENCE)


def test_a_request_that_is_repeated_is_the_same_goal_and_a_bad_one_changes_nothing(driven):
    goal_id, unknown = new_goal_id(), new_goal_id()
    assert send(driven, goal_id, FAR).reason == "driving"
    assert send(driven, goal_id, FAR).reason == "driving"
    bad = send(driven, new_goal_id(), (float("nan"), 0.0, 0.0))
    assert (bad.successful, bad.reason) == (False, "x = nan: must be a finite number [m]")
    assert send(driven, goal_id).reason == "driving", "a question"
    assert send(driven, new_goal_id(), NEAR).successful
    again = send(driven, goal_id, FAR)
    assert (again.successful, again.reason) == (True, "replaced: by a newer goal (request)")
    assert "-3 -4.5 0.5" in goal_of(driven), "the newer goal is kept"
    answer = send(driven, unknown)
    assert (answer.successful, answer.reason) == (False, f"goal {unknown} is unknown")


def test_cancel_goal_follows_action_msgs(driven):
    goal_id, other = new_goal_id(), new_goal_id()
    send(driven, goal_id, FAR)
    response = CancelGoal.Response
    assert cancel_goal(driven, other).return_code == response.ERROR_UNKNOWN_GOAL_ID
    assert cancel_goal(driven, sec=1).return_code == response.ERROR_REJECTED, "no goal is that old"
    assert send(driven, goal_id).reason == "driving"
    answer = cancel_goal(driven, goal_id)
    assert answer.return_code == response.ERROR_NONE
    assert [bytes(info.goal_id.uuid).hex() for info in answer.goals_canceling] == [goal_id]
    assert send(driven, goal_id).reason == "cancelled"
    assert cancel_goal(driven, goal_id).return_code == response.ERROR_GOAL_TERMINATED
    send(driven, other, FAR)
    assert len(cancel_goal(driven).goals_canceling) == 1, "all"
    assert cancel_goal(driven).return_code == response.ERROR_REJECTED
    send(driven, new_goal_id(), FAR)
    assert len(cancel_goal(driven, sec=2**31 - 1).goals_canceling) == 1, "all until then"
    driven.peer.spin_until(lambda: driven.commands and twist(driven.commands[-1]) == (0.0, 0.0), what="rest")


def test_a_late_subscriber_receives_states_and_ends(driven):
    goal_id = new_goal_id()
    send(driven, goal_id, FAR)
    send(driven, new_goal_id(), FAR)  # not reached before the late one is there
    with graph.peer("late") as late:
        states = late.subscribe(GoalStatusArray, "controller/goal_status", LATCHED)
        results = late.subscribe(DiagnosticArray, "controller/goal_results", LATCHED)
        late.spin_until(lambda: states and results, what="the latched messages")
        by_id = {bytes(one.goal_info.goal_id.uuid).hex(): one.status for one in states[-1].status_list}
        assert by_id[goal_id] == GoalStatus.STATUS_ABORTED
        assert states[-1].status_list[-1].status == GoalStatus.STATUS_EXECUTING
        ends = {one.name: one for one in results[-1].status}
        assert ends[goal_id].message == "replaced"
        assert graph.values(ends[goal_id])["reason"] == "by a newer goal (request)"
