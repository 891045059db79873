"""SIGINT and SIGTERM at any time, kill -9 of robot_node, and a full disk."""

import resource
import signal
import sys
import time
from functools import partial

import graph
import pytest
from bag_makers import read, unfinished
from repeated import tried
from witness import NEAR

from diffbot_core.ros.run import READERS_TIMEOUT
from diffbot_core.yaml_files import MAX_BYTES

RECORDER = "diffbot_bag.recorder_node"
SIGNALS = (signal.SIGINT, signal.SIGTERM)
STOP = (0.0, 0.0)
END, ZERO = 2.0, 0.2
"""[s] within which a node ends, and within which a driving controller has sent zero"""
EACH_NODE = pytest.mark.parametrize(
    ("robot", "name"),
    [
        ("apart", "controller"),
        ("together", "robot"),
        pytest.param("apart", "ekf", marks=pytest.mark.slow),
        pytest.param("apart", "plant", marks=pytest.mark.slow),
    ],
)
FILE_LIMIT = 40_000
"""[bytes] Beyond this size, a write fails as on a full disk."""
MAX_START_LINES = 700
"""A node writes about 500 lines until it is ready: some of the signals are sent afterwards."""
STARTED = {**graph.MODULES, "recorder": RECORDER}


@pytest.fixture(scope="module")
def apart(observed):
    with observed(NEAR) as witness:
        yield witness


@pytest.fixture(scope="module")
def together(observed):
    with observed(NEAR, only=("robot", "plant"), namespace="/together") as witness:
        yield witness


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
    witness.robot.start(name, NEAR if name == "plant" else None)


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
def test_the_controller_ends_although_its_base_is_held_up(apart, trials, seeded):
    for number in trials:
        apart.drive()
        apart.wait(seeded)
        process = apart.robot.processes["controller"]
        apart.kill("plant", signal.SIGSTOP)
        try:
            # The controller waits for the base twice: after the zero command, and before it destroys its publishers.
            check_end(process, apart.kill("controller", SIGNALS[number % 2]), trials, END + READERS_TIMEOUT)
            check_zero(apart)
        finally:
            apart.kill("plant", signal.SIGCONT)
        restart(apart, "controller")


@tried(20)
def test_a_signal_ends_the_recorder_with_a_finished_bag(apart, trials, seeded, tmp_path):
    apart.drive()
    for number in trials:
        folder = tmp_path / str(number)
        with graph.node(RECORDER, {"uri": folder, "flush_period": 0.1}) as recorder:
            recorder.wait_for_output("ready")
            graph.wait_for(lambda folder=folder: unfinished(folder / f"{folder.name}_0.mcap"), what="messages")
            apart.wait(seeded)
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
def test_a_full_disk_ends_the_recording_with_one_error_and_the_robot_drives_on(apart, trials, tmp_path):
    apart.drive()
    for number in trials:
        folder = tmp_path / str(number)
        parameters = {"uri": folder, "flush_period": 0.1, "topics": ["/ground_truth"], "compression": "none"}
        environment = graph.environment(ROS_LOG_DIR=str(tmp_path / "log"))
        with graph.node(RECORDER, parameters, env=environment, preexec_fn=limited) as recorder:
            apart.peer.spin_until(lambda recorder=recorder: recorder.popen.poll() is not None, what="the end")
            assert recorder.popen.poll() == 1
            assert len([line for line in recorder.output.splitlines() if "ERROR" in line]) == 1
            assert "Traceback" not in recorder.output
        assert len(unfinished(folder / f"{number}_0.mcap")) > 5
        apart.until_moving()
