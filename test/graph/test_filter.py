"""The filter's node in the graph: how it starts, its sources, its reset, and its states."""

import graph
import numpy as np
import pytest
from filter_input import fix, odometry
from geometry_msgs.msg import PoseWithCovarianceStamped
from graph import MODULES
from nav_msgs.msg import Odometry
from robot import DEEP, distance, initialpose, lockstep, planar, robot, stamp, turned
from std_srvs.srv import Trigger

NO_FIXES = {"fix_rate": 0.0, "initial_pose.x": 1.0, "initial_pose.y": -2.0, "initial_pose.yaw": 2.0}


def state_of(robot):
    return robot.ekf_states[-1].message if robot.ekf_states else ""


def test_without_fixes_it_waits_for_initialpose_and_then_follows_the_odometry():
    with robot(NO_FIXES, namespace="/blind") as blind:
        blind.peer.spin_until(lambda: len(blind.truths) > 5, 5.0, "steps")
        blind.peer.spin_until(lambda: state_of(blind) == "waiting for first fix", 5.0, "waiting")
        assert not blind.poses
        publisher = blind.peer.publisher(PoseWithCovarianceStamped, "initialpose")
        blind.peer.wait_for_subscribers(publisher)
        publisher.publish(initialpose(1.0, -2.0, 2.0))
        blind.peer.spin_until(lambda: blind.poses, 5.0, "a pose")
        assert planar(blind.poses[0].pose.pose) == pytest.approx((1.0, -2.0, 2.0), abs=1e-3)
        blind.peer.spin_until(lambda: state_of(blind) == "running", 3.0, "running")
        blind.send_goal(2.5, -2.0, 0.0)
        blind.peer.spin_until(lambda: distance(blind.true_pose(), (1.0, -2.0)) > 0.5, 10.0, "motion")
        # Twists in, no fix: the filter drifts no more than the encoders' 5 %.
        truth = {stamp(one): planar(one.pose.pose) for one in blind.truths}
        estimate = blind.poses[-1]
        assert distance(planar(estimate.pose.pose), truth[stamp(estimate)]) < 0.15
        # Told otherwise, it believes it.
        publisher.publish(initialpose(9.0, 9.0, 0.0))
        blind.peer.spin_until(lambda: planar(blind.poses[-1].pose.pose)[0] > 8.5, 3.0, "the new pose")
        # The odometry falls silent.
        blind.processes["plant"].stop()
        blind.peer.spin_until(lambda: state_of(blind) == "no odometry", 5.0, "no odometry")


@pytest.fixture(scope="module")
def twins():
    """One robot with two filters, of which one reads the wheels; in lock-step, so that both see each step."""
    with lockstep({"seed": 21}) as running:
        arguments = ("-r", "__node:=second", "-r", "pose:=pose2", "-r", "odometry/filtered:=filtered2")
        with graph.node(MODULES["ekf"], {"odometry_source": "joint_states"}, arguments) as second:
            second.wait_for_output("]: ready")
            running.second = running.peer.subscribe(PoseWithCovarianceStamped, "pose2", DEEP)
            running.filtered = running.peer.subscribe(Odometry, "odometry/filtered", DEEP)
            # Far from the goal again when all are heard.
            running.pause(False)
            heard = (running.second, running.filtered, running.truths, running.poses)
            running.peer.spin_until(lambda: all(heard), 10.0, "both filters")
            running.send_goal(0.0, 0.0, 0.0)
            # By stamps: a step that was sent again is answered again.
            count = len(by_stamp(running.second))
            running.peer.spin_until(lambda: len(by_stamp(running.second)) > count + 150, 20.0, "150 steps")
            running.pause(True)
            running.catch_up()
            yield running


def by_stamp(messages):
    return {stamp(message): planar(message.pose.pose) for message in messages}


def test_estimate_is_better_than_a_fix(twins):
    truth, estimate = by_stamp(twins.truths), by_stamp(twins.poses)
    late = sorted(truth.keys() & estimate.keys())[50:]
    assert len(late) > 80
    errors = [distance(estimate[when], truth[when]) for when in late]
    assert np.mean(errors) < 0.1  # a fix is 0.23 m off on average
    assert np.mean([turned(estimate[when], truth[when]) for when in late]) < 0.05


def test_wheel_speeds_give_the_same_estimate_as_odometry(twins):
    """The plant's odometry is made of its joint states; only the order of fix and joint state may differ."""
    one, other = by_stamp(twins.poses), by_stamp(twins.second)
    common = sorted(one.keys() & other.keys())[10:]
    assert len(common) > 80
    assert np.median([distance(one[when], other[when]) for when in common]) < 0.02
    assert max(distance(one[when], other[when]) for when in common) < 0.3


def test_filtered_odometry_is_the_same_estimate_with_the_twist(twins):
    poses, filtered = by_stamp(twins.poses), by_stamp(twins.filtered)
    common = poses.keys() & filtered.keys()
    assert len(common) > 100
    assert all(poses[when] == filtered[when] for when in common)
    assert twins.filtered[0].child_frame_id == "base_link"
    assert max(abs(one.twist.twist.linear.x) for one in twins.filtered) > 0.5
    assert all(np.linalg.eigvalsh(np.array(one.pose.covariance).reshape(6, 6))[0] > 0.0 for one in twins.poses[20::20])


def test_reset_forgets_and_the_next_fix_starts_anew(twins):
    answer = twins.peer.call(Trigger, "ekf/reset")
    assert (answer.success, answer.message) == (True, "waiting for the next fix")
    twins.peer.spin_until(lambda: state_of(twins) == "waiting for first fix", 3.0, "waiting")
    count = len(twins.poses)
    twins.pause(False)
    twins.peer.spin_until(lambda: len(twins.poses) > count + 3, 10.0, "poses")
    twins.pause(True)
    twins.catch_up()
    # One fix: as uncertain as it is, uniform within 0.3 m.
    first = np.array(twins.poses[count].pose.covariance)[[0, 7]]
    assert first == pytest.approx([0.03, 0.03], rel=0.3)
    assert np.all(first > 3 * np.array(twins.poses[count - 1].pose.covariance)[[0, 7]])


def test_a_further_source_of_fixes_has_its_own_deviations_and_delay():
    """Its fix is measured 0.1 s before its stamp: taken as later, the odometry would come out of order."""
    parameters = {
        "reliable_inputs": True,  # the fix is sent once
        "pose_sources": ["gps"],
        "pose_source_sigma_xy": [0.2],
        "pose_source_sigma_yaw": [0.1],
        "pose_source_delay": [0.1],
    }
    with (
        graph.node(MODULES["ekf"], parameters, ("-r", "__ns:=/sources")) as process,
        graph.peer(namespace="/sources") as peer,
    ):
        process.wait_for_output("]: ready")
        poses = peer.subscribe(PoseWithCovarianceStamped, "pose", DEEP)
        gps, odom = peer.publisher(PoseWithCovarianceStamped, "gps"), peer.publisher(Odometry, "odom")
        peer.wait_for_subscribers(gps, odom)
        message = fix(1000.1)
        message.pose.covariance[:] = 0.0
        gps.publish(message)

        def answered():
            odom.publish(odometry(1000.0))
            return poses

        peer.spin_until(answered, 5.0, "a pose")
        assert stamp(poses[0]) == 1000 * 10**9
        assert planar(poses[0].pose.pose) == pytest.approx((1.0, 2.0, 0.5))
        assert np.array(poses[0].pose.covariance)[[0, 7, 35]] == pytest.approx([0.04, 0.04, 0.01])
