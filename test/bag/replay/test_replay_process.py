"""The replay as a process: between processes, in a terminal, and its end by a signal or a wrong bag."""

import os
import termios

import graph
import pytest
from bag_makers import BEGIN, point
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point
from recorders import LATCHED, recorded
from replays import MS, write_mcap
from terminals import in_terminal

from diffbot_bag.bag.reader import BagReader

pytestmark = pytest.mark.graph

REPLAY = "diffbot_bag.replay_node"
LAST = 300


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """/a at 100 Hz for three seconds, once more an hour later, and the latched /map."""
    times = [BEGIN + index * 10 * MS for index in range(LAST)] + [BEGIN + 3600 * 1000 * MS]
    messages = [("/a", time, point(index)) for index, time in enumerate(times)] + [("/map", BEGIN + 1, point(-1))]
    path = tmp_path_factory.mktemp("bags") / "run.mcap"
    return write_mcap(path, sorted(messages, key=lambda message: message[1]), latched=("/map",))


def test_a_bag_recorded_from_its_own_replay_is_the_same(bag, tmp_path):
    names = {"topics": ["/a", "/map"]}
    with graph.node("diffbot_bag.recorder_node", {"uri": tmp_path / "copy", **names}) as recorder:
        recorder.wait_for_output("ready")
        waits = {"wait_timeout": 60.0, "wait_acked_timeout": 60.0}
        with graph.node(REPLAY, {"uri": bag, **names, **waits, "rate": 5.0, "playback_duration": 3.0}) as running:
            assert running.wait() == 0
        assert recorder.stop() == 0
        assert " 0 lost" in recorder.output
    assert recorded(tmp_path / "copy", "/a") == [point(index) for index in range(LAST)]
    assert recorded(tmp_path / "copy", "/map") == [point(-1)]
    with BagReader(tmp_path / "copy") as copy:
        assert [qos.durability for qos in copy.topics["/map"].qos] == ["transient_local"]
        assert copy.topics["/a"].type_hash.startswith("RIHS01_")


def test_keys_pause_step_and_change_the_rate_and_ctrl_c_restores_the_terminal(bag, terminal):
    ours, theirs = terminal
    before = termios.tcgetattr(theirs)
    with (
        graph.peer() as peer,
        graph.node(REPLAY, {"uri": bag, "rate": 0.05, "wait_timeout": 60.0}, **in_terminal(theirs)) as running,
    ):
        reports = peer.subscribe(DiagnosticStatus, "/replay/status", LATCHED)
        peer.subscribe(Point, "/map")
        received = peer.subscribe(Point, "/a", 1000)

        def reported(key):
            return graph.values(reports[-1])[key]

        running.wait_for_output("keys: space")
        peer.spin_until(lambda: len(received) > 1 and reports, what="messages")
        os.write(ours, b" ")
        peer.spin_until(lambda: reports[-1].message == "paused", what="the pause")
        count = int(reported("messages"))
        os.write(ours, b"\x1b[C\x1b[C")
        peer.spin_until(lambda: int(reported("messages")) >= count + 2, what="two steps")
        # Up twice and down once: 10 % of what it was each time.
        os.write(ours, b"\x1b[A\x1b[A\x1b[B")
        peer.spin_until(lambda: reported("rate") == f"{0.05 * 1.1 * 1.1 * 0.9:g}", what="the rate")
        # One may have been on its way when the pause came.
        assert int(reported("messages")) <= count + 3
        os.write(ours, b"\x03")
        assert running.wait() == 0
    assert termios.tcgetattr(theirs) == before
