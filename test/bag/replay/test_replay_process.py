"""The replay as a process in a terminal."""

import os
import termios

import graph
import pytest
from bag_makers import BEGIN, point
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point
from recorders import LATCHED
from replays import MS, write_mcap
from terminals import in_terminal

pytestmark = pytest.mark.graph


@pytest.fixture
def bag(tmp_path):
    """/a at 100 Hz for three seconds, and the latched /map."""
    messages = [("/a", BEGIN + index * 10 * MS, point(index)) for index in range(300)] + [
        ("/map", BEGIN + 1, point(-1))
    ]
    return write_mcap(tmp_path / "run.mcap", sorted(messages, key=lambda message: message[1]), latched=("/map",))


def test_keys_pause_step_and_change_the_rate_and_ctrl_c_restores_the_terminal(bag, terminal):
    ours, theirs = terminal
    before = termios.tcgetattr(theirs)
    with (
        graph.peer() as peer,
        graph.node(
            "diffbot_bag.replay_node", {"uri": bag, "rate": 0.05, "wait_timeout": 60.0}, **in_terminal(theirs)
        ) as running,
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
