"""SIGINT and SIGTERM at any time, and a disk that is full."""

import contextlib
import resource
import signal
import struct
import sys
import time
from functools import partial

import graph
from mcap.exceptions import EndOfFile
from mcap.records import Message
from mcap.stream_reader import StreamReader
from witness import NEAR

from diffbot_bag.reader import BagReader

RECORDER = "diffbot_bag.recorder_node"
SIGNALS = (signal.SIGINT, signal.SIGTERM)
FILE_LIMIT = 60_000
"""bytes; what the system answers beyond is the same error as on a full disk"""
MAX_START_LINES = 700
"""more than any node writes until it is ready, about 500: some of the signals come afterwards"""
STARTED = {**graph.MODULES, "recorder": RECORDER}


def ended(process, since):
    """Return the time [s] from ``since`` to the end of a process, and whether it ended well."""
    status = process.wait(20.0)
    return time.monotonic() - since, status == 0 and "Traceback" not in process.output


def received_zero(witness, since):
    """Return the time [s] from ``since`` to the first of the zeros that end the commands."""
    return witness.stop_after(since, timeout=5.0)


def test_signals_end_each_node_stop_the_robot_and_close_the_bag(observed, trials, seeded, tmp_path):
    names = ("controller", "ekf", "recorder", "plant")
    with contextlib.ExitStack() as stack:
        running = {name: stack.enter_context(trials(f"end {name}")) for name in names}
        stops = stack.enter_context(trials("end controller, stop"))
        for number in stops:
            folder = tmp_path / str(number)
            with observed(NEAR) as witness, graph.node(RECORDER, {"uri": folder}) as recorder:
                witness.robot.processes["recorder"] = recorder
                recorder.wait_for_output("ready", 60.0)
                witness.drive()
                witness.wait(seeded)
                for name in names:
                    process = witness.robot.processes[name]
                    since = witness.kill(name, SIGNALS[number % 2])
                    if name == "controller":
                        stops.measure(received_zero(witness, since), since)
                        # What follows has been waited for: the end may be earlier than it is measured.
                    seconds, good = ended(process, since)
                    if name == "recorder":
                        good = good and (folder / "metadata.yaml").is_file() and messages_in(folder) > 0
                    running[name].measure(seconds, since, good)


def messages_in(folder):
    with BagReader(folder) as bag:
        return sum(1 for _ in bag.messages())


def test_signals_end_robot_node_and_stop_the_robot(observed, trials, seeded):
    with observed(NEAR, only=("robot", "plant")) as witness, trials("end robot") as running:
        for number in running:
            witness.drive()
            witness.wait(seeded)
            process = witness.robot.processes["robot"]
            since = witness.kill("robot", SIGNALS[number % 2])
            seconds, good = ended(process, since)
            running.measure(seconds, since, good and received_zero(witness, since) <= seconds + 0.25)
            witness.robot.start("robot")


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
                graph.wait_for(begun, 30.0, "a moment of the start")
                since = time.monotonic()
                process.send(SIGNALS[number // len(STARTED) % 2])
                seconds, good = ended(process, since)
                running.measure(seconds, since, good)


def whole_messages(path):
    """Return the number of messages in a file that has no end."""
    count = 0
    with path.open("rb") as stream, contextlib.suppress(EndOfFile, struct.error):
        for record in StreamReader(stream).records:
            count += isinstance(record, Message)
    return count


def limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_LIMIT, FILE_LIMIT))


def test_full_disk_ends_the_recording_with_one_error_and_the_robot_drives_on(observed, trials, tmp_path):
    with observed(NEAR) as witness, trials("disk full") as running:
        witness.drive()
        for number in running:
            folder = tmp_path / str(number)
            full = number % 2 == 0
            parameters = {"uri": folder, "flush_period": 0.1, "chunk_size": 1024}
            options = {"preexec_fn": limited} if full else {}
            environment = graph.environment(ROS_LOG_DIR=str(tmp_path / "log"))
            if not full:
                parameters["min_free_space"] = 10**15
            with graph.node(RECORDER, parameters, env=environment, **options) as recorder:
                status = witness.peer.spin_until(recorder.popen.poll, 60.0, "the end")
                errors = [line for line in recorder.output.splitlines() if "ERROR" in line]
                good = status == 1 and len(errors) == 1 and "Traceback" not in recorder.output
            if full:
                good = good and whole_messages(folder / f"{number}_0.mcap") > 5
            witness.until_moving()
            running.add(kept=good)
