"""kill -9, SIGSTOP and SIGCONT of each node while the robot drives."""

import contextlib
import re
import signal
import time

import graph
import pytest
from bag_makers import unfinished
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from repeated import tried
from robot import stamp
from witness import COMMAND_TIMEOUT, LOST_COMMANDS, LOST_INPUT, NEAR, NEVER, PERIOD, POSE_TIMEOUT

RECORDER = "diffbot_bag.recorder_node"
LOST_MESSAGES = 0.5
"""[s] of a recorder with default parameters"""
KEEPING = {"pose_lost_timeout": 0.0}
"""The controller keeps its goal until the source of poses has started again."""


@pytest.fixture(scope="module")
def driving(observed):
    with observed(NEAR, controller=KEEPING) as witness:
        yield witness


@pytest.fixture
def patient_base(driving):
    """Drive a robot whose base keeps its last command, so that the controller has to stop it."""
    assert driving.robot.set_parameter("plant", "cmd_vel_timeout", NEVER).successful
    driving.drive()
    yield driving
    assert driving.robot.set_parameter("plant", "cmd_vel_timeout", COMMAND_TIMEOUT).successful


@contextlib.contextmanager
def without(witness, fault, name, parameters=None):
    """Kill or stop a node and yield the time before; start or continue the node at the end."""
    if fault == "kill":
        yield witness.kill(name)
        witness.robot.start(name, parameters)
        return
    since = witness.kill(name, signal.SIGSTOP)
    try:
        yield since
    finally:
        witness.kill(name, signal.SIGCONT)


@tried(20)
@pytest.mark.parametrize(
    ("name", "fault"),
    [("ekf", "kill"), ("ekf", "stop"), ("plant", "stop"), pytest.param("plant", "kill", marks=pytest.mark.slow)],
)
def test_a_lost_source_of_poses_stops_the_robot(fault, name, patient_base, trials, seeded):
    parameters = {**NEAR, "cmd_vel_timeout": NEVER} if name == "plant" else None
    for _ in patient_base.moments(trials, seeded):
        with without(patient_base, fault, name, parameters) as since:
            patient_base.check_stop(trials, LOST_INPUT, since)


@tried(20)
@pytest.mark.parametrize("fault", ["kill", "stop"])
def test_the_base_stops_without_its_controller(fault, driving, trials, seeded):
    driving.drive()
    # A controller that was stopped keeps its goal; a new controller does not have a goal.
    for _ in driving.moments(trials, seeded, driving.drive if fault == "kill" else None):
        with without(driving, fault, "controller", KEEPING) as since:
            driving.check_stop(trials, LOST_COMMANDS, since, driving.truths)


def recordings(driving, trials, folder):
    """Yield, for each trial, a recorder that has written ten true poses, and the folder of its bag."""
    for number in trials:
        bag = folder / f"bag_{number}"
        with graph.node(RECORDER, {"uri": bag, "topics": ["/ground_truth"]}) as recorder:
            recorder.wait_for_output("ready")
            driving.peer.spin_until(lambda bag=bag: len(true_poses(bag)) >= 10, what="ten poses in the bag")
            yield recorder, bag


def true_poses(folder):
    """Return the true poses in a bag that may be unfinished, with their times of receipt [ns]."""
    messages = unfinished(folder / f"{folder.name}_0.mcap")
    return [(one.log_time, deserialize_message(one.data, Odometry)) for one in messages]


@tried(20)
def test_a_killed_recorder_leaves_a_readable_bag_and_the_robot_drives_on(driving, trials, seeded, tmp_path):
    driving.drive()
    for recorder, bag in recordings(driving, trials, tmp_path):
        driving.wait(seeded)
        since, wall = driving.mark(), time.time_ns()
        recorder.send(signal.SIGKILL)
        recorder.wait()
        driving.until_moving()
        stopped = [value for at, value in driving.commands if at >= since and value == (0.0, 0.0)]
        # Nodes that have waited for a processor longer than pose_timeout have to stop the robot.
        assert not stopped or driving.delay() >= POSE_TIMEOUT
        assert (wall - true_poses(bag)[-1][0]) * 1e-9 <= trials.bound(LOST_MESSAGES)
        assert "Traceback" not in recorder.output


@tried(5, once=0)
def test_a_recorder_that_was_held_up_counts_the_lost_messages(driving, trials, tmp_path):
    driving.drive()
    for recorder, bag in recordings(driving, trials, tmp_path):
        recorder.send(signal.SIGSTOP)
        driving.peer.spin_for(2.0)
        since = time.time_ns()
        recorder.send(signal.SIGCONT)
        driving.until_moving()
        # On a busy machine the recorder continues later than the robot is observed.
        driving.peer.spin_until(lambda bag=bag, since=since: true_poses(bag)[-1][0] > since, 20.0, "a pose after it")
        assert recorder.stop() == 0
        lost = int(re.search(r"(\d+) lost", recorder.output)[1])
        stamps = [stamp(truth) for _, truth in true_poses(bag)]
        expected = round((stamps[-1] - stamps[0]) / (PERIOD * 1e9)) + 1
        assert expected >= 20
        assert len(stamps) + lost == expected
