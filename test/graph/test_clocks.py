"""The plant's clocks, its pause and its reset."""

import itertools
import time

import pytest
from robot import SIMULATED, planar, robot, stamp
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

PLACE = {"initial_pose.x": 3.0, "initial_pose.y": -1.0, "initial_pose.yaw": 1.0}
PERIOD = 100_000_000


@pytest.fixture(scope="module")
def walking():
    with robot({**PLACE, "start_paused": True, "seed": 9}) as running:
        running.clocks = running.peer.subscribe(Clock, "/clock", 100)
        yield running


def test_paused_at_the_start_it_sends_nothing(walking):
    walking.peer.spin_for(0.5)
    assert not walking.truths
    assert not walking.poses


def test_wall_clock_stamps_with_the_time_of_day_at_ten_a_second(walking):
    assert walking.pause(False).message == "running"
    walking.peer.spin_until(lambda: len(walking.truths) >= 25, 10.0, "25 steps")
    stamps = [stamp(message) for message in walking.truths]
    assert {after - before for before, after in itertools.pairwise(stamps)} == {PERIOD}
    assert abs(time.time_ns() - stamps[-1]) < 0.5e9
    assert planar(walking.truths[0].pose.pose) == (3.0, -1.0, 1.0)
    assert not walking.clocks, "wall time needs no /clock"
    diagnosis = walking.diagnosis("plant")
    assert float(diagnosis["odom sent [Hz]"]) == pytest.approx(10.0, abs=2.0)


def test_pause_stops_the_robot_and_its_messages_and_wall_time_goes_on_in_it(walking):
    assert walking.pause(True).message == "paused"
    walking.catch_up()
    count = len(walking.truths)
    walking.peer.spin_for(1.0)
    assert len(walking.truths) == count
    walking.pause(False)
    walking.peer.spin_until(lambda: len(walking.truths) > count + 3, 5.0, "steps")
    gap = stamp(walking.truths[count]) - stamp(walking.truths[count - 1])
    assert 0.9e9 < gap < 5e9
    assert abs(time.time_ns() - stamp(walking.truths[-1])) < 0.5e9


def test_reset_puts_it_back_without_turning_back_time(walking):
    walking.send_goal(0.0, 0.0, 0.0)
    walking.peer.spin_until(lambda: planar(walking.truths[-1].pose.pose)[0] != 3.0, 5.0, "motion")
    walking.cancel()
    walking.peer.spin_for(0.5)
    count = len(walking.truths)
    answer = walking.peer.call(Trigger, "plant/reset")
    assert answer.success
    walking.peer.spin_until(
        lambda: planar(walking.truths[-1].pose.pose) == (3.0, -1.0, 1.0), 3.0, "the start pose without a command"
    )
    stamps = [stamp(message) for message in walking.truths[count - 1 :]]
    assert all(after > before for before, after in itertools.pairwise(stamps))


def test_scaled_clock_comes_first_and_nodes_follow_it():
    plant = {"clock": "scaled", "real_time_factor": 5.0, "start_time": 5000.0, "start_paused": True}
    with robot(plant, SIMULATED, SIMULATED, namespace="/scaled") as scaled:
        clocks = scaled.peer.subscribe(Clock, "/clock", 1000)
        scaled.pause(False)
        scaled.peer.spin_until(lambda: len(scaled.truths) > 10, 10.0, "steps")
        scaled.wait_for_odometry_rate(50.0)
        # A node that follows /clock stamps its reports with it.
        now = scaled.peer.spin_until(
            lambda: next(
                (
                    array.header.stamp.sec
                    for array in reversed(scaled.diagnostics)
                    if array.status[0].name == "/scaled/controller" and array.header.stamp.sec
                ),
                None,
            ),
            5.0,
            "a report in simulated time",
        )
        assert 5000 <= now < 5200
        scaled.pause(True)
        scaled.catch_up()
        last = stamp(scaled.truths[-1])
        # Simulated time stands still in a pause, and the watch for silence with it.
        scaled.peer.spin_for(0.7)
        scaled.pause(False)
        scaled.peer.spin_until(lambda: stamp(scaled.truths[-1]) > last, 3.0, "the next step")
        after = [stamp(message) for message in scaled.truths if stamp(message) > last]
        assert after[0] == last + PERIOD
        scaled.peer.spin_until(
            lambda: set(after) <= {message.clock.sec * 10**9 + message.clock.nanosec for message in clocks},
            3.0,
            "the time of each step on /clock",
        )
