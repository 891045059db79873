"""kill -9, SIGSTOP and SIGCONT of each node while the robot drives."""

import re
import signal
import struct
import time

import graph
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from nav_msgs.msg import Odometry
from promises import COMMAND_TIMEOUT, FLUSH_PERIOD, NEVER, PERIOD, POSE_TIMEOUT
from rclpy.serialization import deserialize_message
from robot import LATCHED, stamp
from witness import NEAR

RECORDER = "diffbot_bag.recorder_node"


@pytest.fixture(scope="module")
def driving(observed):
    with observed(NEAR) as witness:
        yield witness


@pytest.fixture
def patient_base(driving):
    """Make the base hold its last command, so that the controller has to stop the robot; drive."""
    assert driving.robot.set_parameter("plant", "cmd_vel_timeout", NEVER).successful
    driving.drive()
    yield driving
    assert driving.robot.set_parameter("plant", "cmd_vel_timeout", COMMAND_TIMEOUT).successful


@pytest.mark.parametrize("name", ["ekf", "plant"])
def test_killed_source_of_poses_stops_the_robot(name, patient_base, trials, seeded):
    witness = patient_base
    parameters = {**NEAR, "cmd_vel_timeout": NEVER} if name == "plant" else None
    with trials(f"kill {name}") as running:
        for _ in witness.moments(running, seeded):
            witness.measure_stop(running, witness.kill(name))
            witness.robot.start(name, parameters)


@pytest.mark.parametrize("name", ["ekf", "plant"])
def test_held_up_source_of_poses_stops_the_robot(name, patient_base, trials, seeded):
    witness = patient_base
    with trials(f"stop {name}") as running:
        for _ in witness.moments(running, seeded):
            since = witness.kill(name, signal.SIGSTOP)
            try:
                witness.measure_stop(running, since)
            finally:
                witness.kill(name, signal.SIGCONT)


def test_killed_controller_lets_the_base_stop(driving, trials, seeded):
    with trials("kill controller") as running:
        for _ in driving.moments(running, seeded, driving.drive):
            driving.measure_stop(running, driving.kill("controller"), driving.truths)
            driving.robot.start("controller")


def test_held_up_controller_lets_the_base_stop(driving, trials, seeded):
    with trials("stop controller") as running:
        driving.drive()
        # Held up, the controller keeps its goal.
        for _ in driving.moments(running, seeded):
            since = driving.kill("controller", signal.SIGSTOP)
            try:
                driving.measure_stop(running, since, driving.truths)
            finally:
                driving.kill("controller", signal.SIGCONT)


def recording(driving, folder):
    """Run a recorder of the true poses; it has ten of them when it is given."""
    parameters = {"uri": folder, "flush_period": FLUSH_PERIOD, "topics": ["/ground_truth"]}
    context = graph.node(RECORDER, parameters)
    reports = driving.peer.subscribe(DiagnosticStatus, "recorder/status", LATCHED)
    return context, lambda: reports and int(graph.values(reports[-1]).get("messages", 0)) >= 10


def recordings(driving, running, folder):
    """Yield a recorder with ten true poses and the folder of its bag, for each trial."""
    for number in running:
        bag = folder / f"bag_{number}"
        context, has_recorded = recording(driving, bag)
        with context as recorder:
            driving.peer.spin_until(has_recorded, 20.0, "ten messages in the bag")
            yield recorder, bag


def true_poses(folder):
    """Return the true poses in a bag that may be unfinished, with their times of receipt [ns]."""
    found = []
    with (folder / f"{folder.name}_0.mcap").open("rb") as file:
        try:
            for one in StreamReader(file).records:
                assert not isinstance(one, Channel) or one.topic == "/ground_truth"
                if isinstance(one, Message):
                    found.append((one.log_time, deserialize_message(one.data, Odometry)))
        # The library raises either one, by where the end of what is written comes: within a number, or before it.
        except (EndOfFile, struct.error):
            pass
    return found


def test_killed_recorder_leaves_the_robot_driving_and_a_readable_bag(driving, trials, seeded, tmp_path):
    driving.drive()
    with trials("kill recorder") as running:
        for recorder, bag in recordings(driving, running, tmp_path):
            driving.wait(seeded)
            since, wall = driving.mark(), time.time_ns()
            recorder.send(signal.SIGKILL)
            recorder.wait()
            driving.until_moving()
            stopped = [value for at, value in driving.commands if at >= since and value == (0.0, 0.0)]
            # Nodes that have waited for a processor longer than pose_timeout stop the robot, and rightly so.
            drives_on = not stopped or driving.delay() >= POSE_TIMEOUT
            running.measure((wall - true_poses(bag)[-1][0]) * 1e-9, kept=drives_on)
            assert "Traceback" not in recorder.output


def test_held_up_recorder_counts_what_it_missed(driving, trials, tmp_path):
    driving.drive()
    with trials("stop recorder") as running:
        for recorder, bag in recordings(driving, running, tmp_path):
            recorder.send(signal.SIGSTOP)
            driving.peer.spin_for(2.0)
            since = time.time_ns()
            recorder.send(signal.SIGCONT)
            driving.until_moving()
            # On a busy machine the robot is observed sooner than the recorder has gone on.
            driving.peer.spin_until(
                lambda bag=bag, since=since: true_poses(bag)[-1][0] > since, 20.0, "a pose after it"
            )
            assert recorder.stop() == 0
            lost = int(re.search(r"(\d+) lost", recorder.output)[1])
            stamps = [stamp(truth) for _, truth in true_poses(bag)]
            expected = round((stamps[-1] - stamps[0]) / (PERIOD * 1e9)) + 1
            assert expected >= 20
            running.add(kept=len(stamps) + lost == expected)
