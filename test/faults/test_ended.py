"""SIGINT and SIGTERM at any time, kill -9 of the process of filter and controller, and a disk that is full."""

import contextlib
import resource
import signal
import sys
import time
from functools import partial

import graph
import pytest
from bag_makers import read, unfinished
from witness import NEAR

RECORDER = "diffbot_bag.recorder_node"
SIGNALS = (signal.SIGINT, signal.SIGTERM)
STOP = (0.0, 0.0)
FILE_LIMIT = 40_000
"""bytes; what the system answers beyond is the same error as on a full disk"""
MAX_START_LINES = 700
"""more than any node writes until it is ready, about 500: some of the signals come afterwards"""
STARTED = {**graph.MODULES, "recorder": RECORDER}


@pytest.fixture(scope="module")
def apart(observed):
    """Have a robot of three processes."""
    with observed(NEAR) as witness:
        yield witness


@pytest.fixture(scope="module")
def together(observed):
    """Have a robot whose filter and controller are one process."""
    with observed(NEAR, only=("robot", "plant"), namespace="/together") as witness:
        yield witness


def ended(process, since):
    """Return the time [s] from ``since`` to the end of a process, and whether it ended well."""
    status = process.wait()
    return time.monotonic() - since, status == 0 and "Traceback" not in process.output and stops_first(process.output)


def stops_first(log):
    """True unless the log of robot_node has the filter, which may have to save its state, end before the controller."""
    ends = [log.find(f"[{name}]: inactive") for name in ("controller", "ekf")]
    return min(ends) < 0 or ends[0] < ends[1]


def restart(witness, name):
    witness.robot.start(name, NEAR if name == "plant" else None)


def ends_with_zero(witness):
    """Return whether the last command is zero; after the end of a source of poses, that takes pose_timeout."""
    witness.peer.comes_true(lambda: witness.commands[-1][1] == STOP, 10.0)
    witness.robot.catch_up()
    return witness.commands[-1][1] == STOP


@pytest.mark.parametrize(("robot", "names"), [("apart", ("controller", "ekf", "plant")), ("together", ("robot",))])
def test_signals_end_each_node_of_a_driving_robot_and_stop_it(robot, names, request, trials, seeded):
    witness = request.getfixturevalue(robot)
    with contextlib.ExitStack() as stack:
        running = {name: stack.enter_context(trials(f"end {name}")) for name in names}
        stops = stack.enter_context(trials("end controller, stop")) if "controller" in names else None
        for number in next(iter(running.values())):
            for name in names:
                witness.drive()
                witness.wait(seeded)
                process = witness.robot.processes[name]
                since = witness.kill(name, SIGNALS[number % 2])
                if name == "controller":
                    stops.measure(witness.stop_after(since), delay=witness.delay())
                    # What follows has been waited for: the end may be earlier than it is measured.
                seconds, good = ended(process, since)
                running[name].measure(seconds, good and ends_with_zero(witness))
                restart(witness, name)


def test_last_command_is_zero_whichever_node_ends(request, trials, seeded):
    """The signals come twice, as from `ros2 launch`; `make faults` has four busy loops beside it."""
    cases = ("apart", "controller"), ("together", "robot"), ("apart", "ekf"), ("together", "plant")
    # Most of the trials for the nodes that publish the command.
    cases = (*cases, *cases[:2] * 3)
    with trials("end, last command") as running:
        for number in running:
            robot, name = cases[number % len(cases)]
            witness = request.getfixturevalue(robot)
            witness.drive()
            witness.wait(seeded)
            process = witness.robot.processes[name]
            since = witness.kill(name, SIGNALS[number % 2])
            process.send(SIGNALS[(number + 1) % 2])
            _, good = ended(process, since)
            running.add(kept=good and ends_with_zero(witness))
            if not running.results[-1][2]:
                print(f"trial {number}, {name} ended: {witness.commands[-5:]}")
            restart(witness, name)


def test_a_reader_that_is_held_up_does_not_hold_up_the_end_of_the_controller(apart, trials, seeded):
    with trials("end controller, reader stopped") as running:
        for number in running:
            apart.drive()
            apart.wait(seeded)
            process = apart.robot.processes["controller"]
            apart.kill("plant", signal.SIGSTOP)
            try:
                since = apart.kill("controller", SIGNALS[number % 2])
                seconds, good = ended(process, since)
                running.measure(seconds, good and ends_with_zero(apart))
            finally:
                apart.kill("plant", signal.SIGCONT)
            restart(apart, "controller")


def test_signals_close_the_bag(apart, trials, seeded, tmp_path):
    with trials("end recorder") as running:
        apart.drive()
        for number in running:
            folder = tmp_path / str(number)
            with graph.node(RECORDER, {"uri": folder, "flush_period": 0.1}) as recorder:
                recorder.wait_for_output("ready")
                graph.wait_for(lambda folder=folder: unfinished(folder / f"{folder.name}_0.mcap"), what="messages")
                apart.wait(seeded)
                since = time.monotonic()
                recorder.send(SIGNALS[number % 2])
                seconds, good = ended(recorder, since)
            running.measure(seconds, good and (folder / "metadata.yaml").is_file() and bool(read(folder)))


def has_begun(process, lines):
    """Return whether a node has written this many lines since it began its own imports, or is ready.

    Before, signals still have the interpreter's default.
    """
    _, launcher, after = process.output.replace("\r", "").partition("diffbot_core.launcher\nimport time:")
    return bool(launcher) and (after.count("\n") >= lines or "ready" in after)


def test_signals_at_the_start_end_a_node_well(trials, seeded, tmp_path):
    # Python then writes a line to stderr for each module, once it is imported.
    environment = graph.environment(PYTHONPROFILEIMPORTTIME="1")
    with trials("end at start") as running:
        for number in running:
            name = list(STARTED)[number % len(STARTED)]
            bag = ("--ros-args", "-p", f"uri:={tmp_path / str(number)}") if name == "recorder" else ()
            with graph.process(sys.executable, "-m", STARTED[name], *bag, env=environment) as process:
                begun = partial(has_begun, process, seeded.randrange(MAX_START_LINES))
                graph.wait_for(begun, what="a moment of the start")
                since = time.monotonic()
                process.send(SIGNALS[number // len(STARTED) % 2])
                seconds, good = ended(process, since)
                running.measure(seconds, good)


def limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_LIMIT, FILE_LIMIT))


def test_full_disk_ends_the_recording_with_one_error_and_the_robot_drives_on(apart, trials, tmp_path):
    with trials("disk full") as running:
        apart.drive()
        for number in running:
            folder = tmp_path / str(number)
            full = number % 2 == 0
            parameters = {"uri": folder, "flush_period": 0.1, "topics": ["/ground_truth"], "compression": "none"}
            options = {"preexec_fn": limited} if full else {}
            environment = graph.environment(ROS_LOG_DIR=str(tmp_path / "log"))
            if not full:
                parameters["min_free_space"] = 10**15
            with graph.node(RECORDER, parameters, env=environment, **options) as recorder:
                apart.peer.spin_until(lambda recorder=recorder: recorder.popen.poll() is not None, what="the end")
                errors = [line for line in recorder.output.splitlines() if "ERROR" in line]
                good = recorder.popen.poll() == 1 and len(errors) == 1 and "Traceback" not in recorder.output
            if full:
                good = good and len(unfinished(folder / f"{number}_0.mcap")) > 5
            apart.until_moving()
            running.add(kept=good)


def test_killed_robot_node_lets_the_base_stop(together, trials, seeded):
    with trials("kill robot") as running:
        for _ in together.moments(running, seeded, together.drive):
            together.measure_stop(running, together.kill("robot"), together.truths)
            restart(together, "robot")
