"""The record of a run, from bags written by hand, and its evaluation."""

import math

import bag_makers
import numpy as np
import pytest
import view_bags

from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_tools.demo.run_record import RunRecord, evaluate, read_run

NOTHING = np.empty((0, 4))


def ns(seconds):
    return view_bags.BEGIN + round(seconds * 1e9)


def odometry(topic, seconds, *pose):
    return topic, ns(seconds), 0, view_bags.odometry(ns(seconds), *pose)


def estimate(topic, seconds, *pose):
    return topic, ns(seconds), 0, view_bags.estimate(ns(seconds), *pose)


def goal(seconds, pose, stamp=0):
    return "/goal_pose", ns(seconds), 0, view_bags.goal(stamp, *pose)


@pytest.fixture
def read(tmp_path):
    """Return a function that reads the run of a bag with these messages."""

    def read_messages(*rows, namespace="", **options):
        folder = bag_makers.write_folder(tmp_path / "made_up", sorted(rows, key=lambda row: row[1]), **options)
        return read_run(folder, namespace)

    return read_messages


def test_a_bag_by_hand(read):
    record = read(
        goal(-0.5, (3.0, 2.0, 1.5)),
        odometry("/ground_truth", 0.0, 1.0, 2.0, 0.5 * math.pi),
        odometry("/odom", 0.0, 7.0, 3.0, 0.0),
        estimate("/pose", 0.0, 1.1, 2.1, 1.6),
        estimate("/global_pose", 0.0, 1.2, 2.2, -3.0),
        estimate("/chatter", 0.0, 9.0, 9.0, 0.9),
        odometry("/ground_truth", 0.1, 1.0, 2.5, 0.5 * math.pi),
        odometry("/odom", 0.1, 7.5, 3.1, 0.2),
        custom_data={"lost_messages": "7"},
    )
    np.testing.assert_allclose(record.truth, [[0.0, 1.0, 2.0, math.pi / 2], [0.1, 1.0, 2.5, math.pi / 2]])
    np.testing.assert_allclose(record.estimate, [[0.0, 1.1, 2.1, 1.6]])
    np.testing.assert_allclose(record.fixes, [[0.0, 1.2, 2.2, -3.0]])
    # Moved onto the truth, which looks along +y: (0.5, 0.1) of the odometry is (-0.1, 0.5) in map.
    np.testing.assert_allclose(
        record.odometry, [[0.0, 1.0, 2.0, math.pi / 2], [0.1, 0.9, 2.5, math.pi / 2 + 0.2]], atol=1e-12
    )
    ((time, found),) = record.goals
    assert (time, *found) == pytest.approx((-0.5, 3.0, 2.0, 1.5))
    assert (record.messages, record.lost) == (8, 7)


def test_a_goal_begins_by_its_stamp_if_that_is_of_this_run(read):
    record = read(
        odometry("/ground_truth", 0.0, 0.0, 0.0, 0.0),
        odometry("/ground_truth", 9.0, 1.0, 0.0, 0.0),
        goal(5.0, (1.0, 0.0, 0.0), stamp=ns(3.0)),
        goal(6.0, (2.0, 0.0, 0.0), stamp=ns(3600.0)),
    )
    assert [time for time, _ in record.goals] == pytest.approx([3.0, 6.0])


def test_another_robots_topics_are_not_taken(read):
    record = read(
        odometry("/ground_truth", 0.0, 9.0, 9.0, 0.0),
        odometry("/r2/ground_truth", 1.0, 1.0, 2.0, 0.0),
        estimate("/r2/pose", 2.0, 1.5, 2.0, 0.0),
        namespace="/r2",
    )
    np.testing.assert_allclose(record.truth, [[0.0, 1.0, 2.0, 0.0]])
    np.testing.assert_allclose(record.estimate, [[1.0, 1.5, 2.0, 0.0]])
    assert record.odometry.shape == record.fixes.shape == (0, 4)
    assert (record.messages, record.lost, record.goals) == (3, 0, [])


def test_a_bag_without_truth_is_refused(read):
    with pytest.raises(DiffbotError, match="made_up: no /r2/ground_truth in it"):
        read(odometry("/ground_truth", 0.0, 1.0, 2.0, 0.0), namespace="/r2")


def line(goals, estimate=NOTHING):
    """Return a record of a robot that drives along x with 1 m/s for 10 s."""
    time = np.arange(0.0, 10.5, 0.5)
    truth = np.column_stack([time, time, np.zeros_like(time), np.full_like(time, 0.05)])
    return RunRecord(truth, estimate, NOTHING, NOTHING, goals, 0, 0)


def test_each_goal_is_evaluated_over_its_own_time():
    estimate = np.array([[4.0, 4.1, 0.0, 0.0], [9.5, 9.5, 0.2, 0.0], [10.0, 10.0, 0.3, 0.0]])
    first, second = evaluate(
        line([(-1.0, Pose(4.0, 0.0, 0.0)), (4.0, Pose(10.5, 0.0, 0.0))], estimate), xy_tolerance=1.0, yaw_tolerance=0.1
    )
    found = [
        (one.metrics.position_error, one.metrics.direct_distance, one.metrics.path_length, one.metrics.settling_time)
        for one in (first, second)
    ]
    assert found == [pytest.approx((0.0, 4.0, 4.0, 3.0)), pytest.approx((0.5, 6.5, 6.0, 5.5))]
    assert (first.goal.x, first.estimation_error) == (4.0, pytest.approx(0.1))
    assert (second.goal.x, second.estimation_error) == (10.5, pytest.approx(0.3))


def test_a_goal_without_any_truth_is_left_out():
    goals = [(1.0, Pose(4.0, 0.0, 0.0)), (1.1, Pose(5.0, 0.0, 0.0)), (1.2, Pose(6.0, 0.0, 0.0))]
    found = evaluate(line([*goals, (50.0, Pose(7.0, 0.0, 0.0))]), 1.0, 0.1)
    assert [result.goal.x for result in found] == [4.0, 6.0]
    # Without an estimate, there is no error of it.
    assert all(math.isnan(result.estimation_error) for result in found)
