"""Nodes of a driving robot are killed, suspended, or ended by SIGINT or SIGTERM at any time; and a full disk."""

import contextlib
import re
import resource
import signal
import sys
import time
from functools import partial

import graph
import pytest
from bag_makers import read, unfinished
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from repeated import tried
from robot import stamp
from witness import COMMAND_TIMEOUT, LOST_COMMANDS, LOST_INPUT, NEAR, NEVER, PERIOD, POSE_TIMEOUT

from diffbot_core.ros.run import READERS_TIMEOUT
from diffbot_core.yaml_files import MAX_BYTES

RECORDER = "diffbot_bag.recorder_node"
LOST_MESSAGES = 0.5
"""[s] of a recorder with default parameters"""
KEEPING = {"pose_lost_timeout": 0.0}
"""The controller keeps its goal until the source of poses has started again."""
SIGNALS = (signal.SIGINT, signal.SIGTERM)
STOP = (0.0, 0.0)
END, ZERO = 2.0, 0.2
"""[s] within which a node ends, and within which a driving controller has sent zero"""
EACH_NODE = pytest.mark.parametrize(
    ("robot", "name"),
    [
        ("driving", "controller"),
        ("together", "robot"),
        pytest.param("driving", "ekf", marks=pytest.mark.slow),
        pytest.param("driving", "plant", marks=pytest.mark.slow),
    ],
)
FILE_LIMIT = 40_000
"""[bytes] Beyond this size, a write fails as on a full disk."""
MAX_START_LINES = 700
"""A node writes about 500 lines until it is ready: some of the signals are sent afterwards."""
STARTED = {**graph.MODULES, "recorder": RECORDER}


@pytest.fixture(scope="module")
def driving(observed):
    with observed(NEAR, controller=KEEPING) as witness:
        yield witness


@pytest.fixture(scope="module")
def together(observed):
    with observed(NEAR, only=("robot", "plant"), namespace="/together") as witness:
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


def check_end(process, since, trials, limit=END):
    """Check that a process ends with status 0, without a traceback and within ``limit`` [s]."""
    status = process.wait()
    seconds = time.monotonic() - since
    assert status == 0
    assert "Traceback" not in process.output
    assert stops_first(process.output)
    assert seconds <= trials.bound(limit)


def stops_first(log):
    """Return False if the filter, which may save its state, ends before the controller in the log of robot_node."""
    ends = [log.find(f"[{name}]: inactive") for name in ("controller", "ekf")]
    return min(ends) < 0 or ends[0] < ends[1]


def restart(witness, name):
    witness.robot.start(name, {"plant": NEAR, "controller": KEEPING}.get(name))


def check_zero(witness):
    """Check that the last command is zero; after the end of a source of poses it comes after pose_timeout."""
    witness.peer.comes_true(lambda: witness.commands[-1][1] == STOP, 10.0)
    witness.robot.catch_up()
    assert witness.commands[-1][1] == STOP, witness.commands[-5:]


@tried(20)
@EACH_NODE
def test_signals_end_a_node_of_a_driving_robot_and_stop_it(robot, name, request, trials, seeded):
    witness = request.getfixturevalue(robot)
    for number in trials:
        witness.drive()
        witness.wait(seeded)
        process = witness.robot.processes[name]
        since = witness.kill(name, SIGNALS[number % 2])
        if number % 4 == 0:
            process.send(SIGNALS[1])  # `ros2 launch` may send two signals
        if name == "controller":
            assert witness.stop_after(since) <= trials.bound(ZERO, witness.delay())
        check_end(process, since, trials)
        check_zero(witness)
        restart(witness, name)


@tried(10, once=0)
def test_the_controller_ends_although_its_base_is_held_up(driving, trials, seeded):
    for number in trials:
        driving.drive()
        driving.wait(seeded)
        process = driving.robot.processes["controller"]
        driving.kill("plant", signal.SIGSTOP)
        try:
            # The controller waits for the base twice: after the zero command, and before it destroys its publishers.
            check_end(process, driving.kill("controller", SIGNALS[number % 2]), trials, END + READERS_TIMEOUT)
            check_zero(driving)
        finally:
            driving.kill("plant", signal.SIGCONT)
        restart(driving, "controller")


@tried(20)
def test_a_signal_ends_the_recorder_with_a_finished_bag(driving, trials, seeded, tmp_path):
    driving.drive()
    for number in trials:
        folder = tmp_path / str(number)
        with graph.node(RECORDER, {"uri": folder, "flush_period": 0.1}) as recorder:
            recorder.wait_for_output("ready")
            graph.wait_for(lambda folder=folder: unfinished(folder / f"{folder.name}_0.mcap"), what="messages")
            driving.wait(seeded)
            since = time.monotonic()
            recorder.send(SIGNALS[number % 2])
            check_end(recorder, since, trials)
        assert (folder / "metadata.yaml").is_file()
        assert read(folder)


def has_begun(process, lines):
    """Return True if a node has written this many lines since the begin of its own imports, or is ready.

    Earlier signals have the default action of the interpreter.
    """
    _, launcher, after = process.output.replace("\r", "").partition("diffbot_core.launcher\nimport time:")
    return bool(launcher) and (after.count("\n") >= lines or "ready" in after)


@tried(50, once=0)
def test_signals_at_the_start_end_a_node_well(trials, seeded, tmp_path):
    # With this variable, Python writes a line to stderr after the import of each module.
    environment = graph.environment(PYTHONPROFILEIMPORTTIME="1")
    # Reading the largest file takes a second.
    file, names = tmp_path / "large.yaml", "".join(f"    n{number}: 1\n" for number in range(MAX_BYTES // 16))
    file.write_text(f"/**:\n  ros__parameters:\n    use_sim_time: false\n/**/other:\n  ros__parameters:\n{names}")
    for number in trials:
        name = list(STARTED)[number % len(STARTED)]
        words = ("-p", f"uri:={tmp_path / str(number)}") if name == "recorder" else ("--params-file", file)
        executable = STARTED[name].rpartition(".")[2]
        start = f"from diffbot.executables import {executable}; raise SystemExit({executable}())"
        with graph.process(sys.executable, "-c", start, "--ros-args", *words, env=environment) as process:
            begun = partial(has_begun, process, seeded.randrange(MAX_START_LINES))
            graph.wait_for(begun, what="a moment of the start")
            since = time.monotonic()
            process.send(SIGNALS[number // len(STARTED) % 2])
            check_end(process, since, trials)


def limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_LIMIT, FILE_LIMIT))


@tried(10, once=0)
def test_a_full_disk_ends_the_recording_with_one_error_and_the_robot_drives_on(driving, trials, tmp_path):
    driving.drive()
    for number in trials:
        folder = tmp_path / str(number)
        parameters = {"uri": folder, "flush_period": 0.1, "topics": ["/ground_truth"], "compression": "none"}
        environment = graph.environment(ROS_LOG_DIR=str(tmp_path / "log"))
        with graph.node(RECORDER, parameters, env=environment, preexec_fn=limited) as recorder:
            driving.peer.spin_until(lambda recorder=recorder: recorder.popen.poll() is not None, what="the end")
            assert recorder.popen.poll() == 1
            assert len([line for line in recorder.output.splitlines() if "ERROR" in line]) == 1
            assert "Traceback" not in recorder.output
        assert len(unfinished(folder / f"{number}_0.mcap")) > 5
        driving.until_moving()
