"""The record of a run, from made-up bags."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_lab.demo import run_record
from diffbot_lab.demo.run_record import RunRecord, evaluate, read_run

SECOND = 10**9
NOTHING = np.empty((0, 4))


def pose_message(pose):
    z, w = math.sin(0.5 * pose[2]), math.cos(0.5 * pose[2])
    orientation = SimpleNamespace(x=0.0, y=0.0, z=z, w=w)
    return SimpleNamespace(position=SimpleNamespace(x=pose[0], y=pose[1]), orientation=orientation)


def stamped(topic, stamp, pose, logged=None):
    """Return a message with a header and a pose with covariance, logged later than it is stamped."""
    sec, nanosec = divmod(stamp, SECOND)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec))
    content = SimpleNamespace(header=header, pose=SimpleNamespace(pose=pose_message(pose)))
    return SimpleNamespace(topic=topic, content=content, log_time=logged or stamp + 5_000_000)


def goal(topic, logged, pose, stamp=0):
    sec, nanosec = divmod(stamp, SECOND)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec))
    content = SimpleNamespace(header=header, pose=pose_message(pose))
    return SimpleNamespace(topic=topic, content=content, log_time=logged)


class MadeUpBag:
    """Stands for BagReader."""

    messages = ()
    metadata = None

    def __init__(self, path):
        self.path = path
        self.message_count = len(self.messages)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def decoded(self, topics):
        return [message for message in self.messages if message.topic in topics]


@pytest.fixture
def bag(monkeypatch):
    def fill(*messages, custom_data=None):
        monkeypatch.setattr(MadeUpBag, "messages", messages)
        metadata = None if custom_data is None else SimpleNamespace(custom_data=custom_data)
        monkeypatch.setattr(MadeUpBag, "metadata", metadata)
        return Path("made_up")

    monkeypatch.setattr(run_record, "BagReader", MadeUpBag)
    return fill


T0 = 1_700_000_000 * SECOND


def test_a_bag_by_hand(bag):
    path = bag(
        goal("/goal_pose", T0 - SECOND // 2, (3.0, 2.0, 1.5)),
        stamped("/ground_truth", T0, (1.0, 2.0, 0.5 * math.pi)),
        stamped("/odom", T0, (0.0, 0.0, 0.0)),
        stamped("/pose", T0, (1.1, 2.1, 1.6)),
        stamped("/global_pose", T0, (1.2, 2.2, -3.0)),
        stamped("/chatter", T0, (9.0, 9.0, 9.0)),
        stamped("/ground_truth", T0 + SECOND // 10, (1.0, 2.5, 0.5 * math.pi)),
        stamped("/odom", T0 + SECOND // 10, (0.5, 0.1, 0.2)),
        custom_data={"lost_messages": "7"},
    )
    record = read_run(path)
    np.testing.assert_allclose(record.truth, [[0.0, 1.0, 2.0, math.pi / 2], [0.1, 1.0, 2.5, math.pi / 2]])
    np.testing.assert_allclose(record.estimate, [[0.0, 1.1, 2.1, 1.6]])
    np.testing.assert_allclose(record.fixes, [[0.0, 1.2, 2.2, -3.0]])
    # The odometry looks along +y as the robot did at the start: (0.5, 0.1) there is (-0.1, 0.5) in map.
    np.testing.assert_allclose(
        record.odometry, [[0.0, 1.0, 2.0, math.pi / 2], [0.1, 0.9, 2.5, math.pi / 2 + 0.2]], atol=1e-12
    )
    (time, found), *others = record.goals
    assert not others
    assert time == pytest.approx(-0.5)
    assert found == pytest.approx((3.0, 2.0, 1.5))
    assert (record.messages, record.lost) == (8, 7)


def test_a_goal_begins_by_its_stamp_if_that_is_of_this_run(bag):
    path = bag(
        stamped("/ground_truth", T0, (0.0, 0.0, 0.0)),
        stamped("/ground_truth", T0 + 9 * SECOND, (1.0, 0.0, 0.0)),
        goal("/goal_pose", T0 + 5 * SECOND, (1.0, 0.0, 0.0), stamp=T0 + 3 * SECOND),
        goal("/goal_pose", T0 + 6 * SECOND, (2.0, 0.0, 0.0), stamp=T0 + 3600 * SECOND),
    )
    assert [time for time, _ in read_run(path).goals] == pytest.approx([3.0, 6.0])


def test_an_odometry_that_did_not_begin_at_its_origin_is_moved_onto_the_truth(bag):
    # A recording that starts in the middle of a drive.
    path = bag(
        stamped("/ground_truth", T0, (1.0, 2.0, 0.0)),
        stamped("/odom", T0, (7.0, 3.0, 0.5 * math.pi)),
        stamped("/odom", T0 + SECOND, (7.0, 4.0, 0.5 * math.pi)),
    )
    np.testing.assert_allclose(read_run(path).odometry, [[0.0, 1.0, 2.0, 0.0], [1.0, 2.0, 2.0, 0.0]], atol=1e-12)


def test_another_robots_topics_are_not_taken(bag):
    path = bag(
        stamped("/ground_truth", T0, (9.0, 9.0, 0.0)),
        stamped("/r2/ground_truth", T0 + SECOND, (1.0, 2.0, 0.0)),
        stamped("/r2/pose", T0 + 2 * SECOND, (1.5, 2.0, 0.0)),
    )
    record = read_run(path, "/r2")
    np.testing.assert_allclose(record.truth, [[0.0, 1.0, 2.0, 0.0]])
    np.testing.assert_allclose(record.estimate, [[1.0, 1.5, 2.0, 0.0]])
    assert record.odometry.shape == record.fixes.shape == (0, 4)
    assert (record.messages, record.lost, record.goals) == (3, 0, [])


def test_a_bag_without_truth_is_refused(bag):
    path = bag(stamped("/pose", T0, (1.0, 2.0, 0.0)))
    with pytest.raises(DiffbotError, match="made_up: no /ground_truth in it"):
        read_run(path)
    with pytest.raises(DiffbotError, match="no /r2/ground_truth in it"):
        read_run(path, "/r2")


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
    assert first.goal == Pose(4.0, 0.0, 0.0)
    assert first.metrics.position_error == 0.0
    assert first.metrics.direct_distance == 4.0
    assert first.metrics.path_length == pytest.approx(4.0)
    assert first.metrics.settling_time == pytest.approx(3.0)
    assert first.estimation_error == pytest.approx(0.1)
    assert second.metrics.direct_distance == pytest.approx(6.5)
    assert second.metrics.path_length == pytest.approx(6.0)
    assert second.metrics.position_error == pytest.approx(0.5)
    assert second.metrics.settling_time == pytest.approx(5.5)
    assert second.estimation_error == pytest.approx(0.3)


def test_a_goal_without_any_truth_is_left_out():
    goals = [(1.0, Pose(4.0, 0.0, 0.0)), (1.1, Pose(5.0, 0.0, 0.0)), (1.2, Pose(6.0, 0.0, 0.0))]
    found = [result.goal.x for result in evaluate(line(goals), 1.0, 0.1)]
    assert found == [4.0, 6.0]
    assert evaluate(line([(50.0, Pose(4.0, 0.0, 0.0))]), 1.0, 0.1) == []
    assert evaluate(line([]), 1.0, 0.1) == []


def test_no_estimate_gives_no_error():
    (result,) = evaluate(line([(0.0, Pose(4.0, 0.0, 0.0))]), 1.0, 0.1)
    assert math.isnan(result.estimation_error)
    assert math.isnan(result.metrics.settling_time)
