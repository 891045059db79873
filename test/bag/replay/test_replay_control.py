"""Control of a replay by services, parameters and keys; several bags; subscribers slower than the replay."""

import fcntl
import os
import termios

import bag_makers
import graph
import pytest
from bag_makers import BEGIN, MS, point, write_mcap, write_rosbags
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point
from rclpy.node import Node
from recorders import DEEP_LATCHED, KEEP_ALL, LATCHED
from replay_nodes import Replay, play

pytestmark = pytest.mark.graph

TOPICS = {"/a": (Point, KEEP_ALL), "/map": (Point, DEEP_LATCHED)}
ROOM = 5000
"""messages that DDS keeps at most on either side"""
COUNT = 2 * ROOM + 500
A, MAP = [point(index) for index in range(1001)], [point(-second) for second in (0, 3, 6)]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Ten seconds: /a at 100 Hz, the latched /map at 0, 3 and 6 s."""
    messages = [("/a", BEGIN + index * 10 * MS, data) for index, data in enumerate(A)]
    messages += [("/map", BEGIN + index * 3000 * MS + 1, data) for index, data in enumerate(MAP)]
    path = tmp_path_factory.mktemp("bags") / "run.mcap"
    offers = {"/map": [bag_makers.LATCHED]}
    return write_mcap(path, sorted(messages, key=lambda message: message[1]), offers=offers)


@pytest.fixture(scope="module")
def long_bag(tmp_path_factory):
    """One topic, more messages than DDS keeps."""
    messages = [("/a", BEGIN + index * MS, point(index)) for index in range(COUNT)]
    return write_mcap(tmp_path_factory.mktemp("bags") / "long.mcap", messages)


def test_seek_burst_and_rate_by_parameters(nodes, bag):
    with Replay(nodes, bag, TOPICS, clock=50.0, burst=2) as replay:
        for topic in TOPICS:
            replay.wait_for(topic, 1)
        assert (replay.of("/a"), replay.of("/map")) == (A[:1], MAP[:1])
        # The same jump twice: to the very message, with the latched one of before it.
        for _ in range(2):
            replay.messages.clear()
            assert replay.set(seek=4.56) == ""
            assert replay.set(burst=3) == ""
            replay.wait_for("/a", 3)
            replay.wait_for("/map", 1)
            assert (replay.of("/a"), replay.of("/map")) == (A[456:459], MAP[1:2])
        replay.messages.clear()
        assert replay.set(seek=0.0) == ""
        assert replay.call("play_next")[0]
        replay.wait_for("/a", 1)
        assert replay.set(seek=10.5) == "seek = 10.5: must be >= 0 s and <= 10 s, the part that is played"
        assert replay.set(seek="soon") == "seek = 'soon': must be a number"
        assert replay.set(rate=0.0) == "rate = 0.0: must be >= 1e-06 and <= 1e+06"
        assert replay.set(burst=-1).startswith("burst = -1: must be >= 0")
        assert replay.set(rate=1e-6) == ""
        assert replay.call("get_rate") == (True, "1e-06")
        assert replay.call("resume")[0]
        assert replay.set(burst=3) == "burst = 3: must be set while the replay is paused"
        # /map comes 1 ns later in the bag, which is 1 ms at this rate; the next /a would come after hours.
        replay.wait_for("/map", 1)
        assert (replay.of("/a"), replay.of("/map")) == (A[:1], MAP[:1])
        assert replay.set(rate=1000.0) == ""
        assert replay.wait_for_end() == 0
    assert (replay.of("/a"), replay.of("/map")) == (A, MAP)


def in_terminal(theirs):
    """Return the options of a process whose stdin is this terminal, in its foreground."""
    return {
        "stdin": theirs,
        "start_new_session": True,
        "preexec_fn": lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        "cwd": "/",  # not the source tree, where a program of -c would find the package first
    }


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


def test_merged_bags_as_fast_as_they_are_acknowledged(nodes, tmp_path):
    one = [("/a", BEGIN + index * 400 * MS, point(index)) for index in range(1000)]
    two = [("/a", time + 200 * MS, point(index + 0.5)) for index, (_, time, _) in enumerate(one)]
    two += [("/b", time + 1, data) for _, time, data in two]
    first = write_mcap(tmp_path / "one.mcap", one)
    second = write_rosbags(tmp_path / "two", sorted(two, key=lambda message: message[1]))
    # Offered reliably all the same.
    (tmp_path / "qos.yaml").write_text("/b: {reliability: best_effort}\n")
    replay = play(
        nodes,
        first,
        {name: (Point, KEEP_ALL) for name in ("/a", "/b")},
        bags=[str(second)],
        as_fast_as_possible=True,
        max_unacknowledged=100,
        qos_profile_overrides_path=str(tmp_path / "qos.yaml"),
    )
    # 400 s of recording; the wait for the end is shorter.
    assert replay.of("/a") == [point(index / 2) for index in range(2000)]
    assert replay.of("/b") == [point(index + 0.5) for index in range(1000)]


def test_a_subscriber_that_takes_nothing_stops_the_replay_or_is_named(nodes, long_bag, capfd):
    silent = Node("silent", context=nodes.peer.context)
    silent.create_subscription(Point, "/a", print, KEEP_ALL)
    waits = {"start_paused": False, "rate": 1000.0, "wait_for_topics": ["/a"]}
    # Without an end to its patience, it waits until it is stopped.
    with Replay(nodes, long_bag, {}, **waits, wait_acked_timeout=0.0) as replay:
        replay.peer.spin_until(lambda: replay.node.health.sent["/a"] >= 2 * ROOM, what="full histories")
        assert replay.call("stop")[0]
        assert replay.wait_for_end() == 0
    assert replay.node.health.sent["/a"] < COUNT
    with Replay(nodes, long_bag, {}, **waits, wait_acked_timeout=0.2) as replay:
        assert replay.wait_for_end() == 0
    assert replay.node.health.sent["/a"] == COUNT
    silent.destroy_node()
    output = capfd.readouterr().err
    assert output.count("/a: not acknowledged after 0.2 s, messages may be lost from now on") == 1
