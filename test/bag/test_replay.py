"""The replay: the messages of a bag are published over DDS, byte by byte and in order, at the requested rate."""

import fcntl
import os
import pty
import re
import termios
from types import SimpleNamespace
from unittest import mock

import bag_makers
import graph
import pytest
from bag_makers import BEGIN, MS, POINT, STRING, point, string, write_mcap, write_rosbags
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point
from rclpy.serialization import deserialize_message, serialize_message
from recorders import BEST_EFFORT, DEEP_LATCHED, KEEP_ALL, LATCHED
from replay_nodes import Replay, play
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from diffbot_bag.bag import BagReader
from diffbot_bag.definitions import type_hash
from diffbot_bag.metadata import Topic
from diffbot_bag.player import Player
from diffbot_bag.publications import Publications
from diffbot_bag.qos import Qos
from diffbot_core.errors import DiffbotError

pytestmark = pytest.mark.graph

TOPICS = {
    "/a": (Point, KEEP_ALL),
    "/noise": (Point, BEST_EFFORT),
    "/text": (String, DEEP_LATCHED),
    "/clock": (Clock, BEST_EFFORT),
}
MAPPED = {"/a": (Point, KEEP_ALL), "/map": (Point, DEEP_LATCHED)}
A, MAP = [point(index) for index in range(1001)], [point(-second) for second in (0, 3, 6)]


def clock(seconds):
    message = Clock()
    message.clock.sec = seconds
    return bytes(serialize_message(message))


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """One second: /a and /noise at 100 Hz, a latched text at 0 s and 0.3 s, a recorded /clock of 1970."""
    kinds = {"/a": POINT, "/noise": POINT, "/text": STRING, "/clock": "rosgraph_msgs/msg/Clock"}
    best_effort = [Qos(reliability="best_effort")]
    offers = {"/a": [Qos()], "/noise": best_effort, "/text": [bag_makers.LATCHED], "/clock": best_effort}
    times = [BEGIN + index * 10 * MS for index in range(101)]
    messages = [("/a", time, point(index)) for index, time in enumerate(times)]
    messages += [("/noise", time + 1, point(-index)) for index, time in enumerate(times)]
    messages += [("/text", times[index] + 2, string(f"text at {index}")) for index in (0, 30)]
    messages += [("/clock", times[index] + 3, clock(index)) for index in range(0, 101, 10)]
    messages.sort(key=lambda message: message[1])
    return write_mcap(tmp_path_factory.mktemp("bags") / "run.mcap", messages, kinds, offers, chunk_size=2000)


@pytest.fixture(scope="module")
def mapped_bag(tmp_path_factory):
    """Ten seconds: /a at 100 Hz, the latched /map at 0, 3 and 6 s."""
    messages = [("/a", BEGIN + index * 10 * MS, data) for index, data in enumerate(A)]
    messages += [("/map", BEGIN + index * 3000 * MS + 1, data) for index, data in enumerate(MAP)]
    path = tmp_path_factory.mktemp("bags") / "run.mcap"
    offers = {"/map": [bag_makers.LATCHED]}
    return write_mcap(path, sorted(messages, key=lambda message: message[1]), offers=offers)


def in_bag(folder, topic, start=0.0, end=2.0):
    with BagReader(folder) as reader:
        window = (BEGIN + round(start * 1000) * MS, BEGIN + round(end * 1000) * MS)
        return [message.data for message in reader.messages([topic], *window)]


def in_order(part, whole):
    """True if all of ``part`` is in ``whole``, once and in the same order."""
    rest = iter(whole)
    return all(one in rest for one in part)


def test_a_replay_sends_all_messages_byte_by_byte_and_in_order(nodes, bag, capfd):
    replay = play(nodes, bag, TOPICS)
    for topic in ("/a", "/text"):
        assert replay.of(topic) == in_bag(bag, topic)
    for topic in ("/noise", "/clock"):
        # A best-effort subscription may miss some, and nothing else.
        assert in_order(replay.of(topic), in_bag(bag, topic))
        assert len(replay.of(topic)) > 0
    assert dict(replay.node.health.sent) == {"/a": 101, "/noise": 101, "/text": 2, "/clock": 11}
    output = capfd.readouterr().err
    assert "215 messages in " in output
    assert "have not acknowledged" not in output


def test_offset_duration_and_rate_apply_and_the_earlier_latched_message_is_sent(nodes, bag, capfd):
    replay = play(nodes, bag, TOPICS, start_offset=0.5, playback_duration=0.2, rate=0.5)
    assert replay.of("/a") == in_bag(bag, "/a", 0.5, 0.7)
    assert replay.of("/text") == [string("text at 30")]
    # A busy machine takes longer, but none is faster.
    assert float(re.search(r"messages in ([\d.]+) s", capfd.readouterr().err)[1]) >= 0.4


def test_topics_are_selected_and_remapped(nodes, bag):
    topics = {"/b": (Point, KEEP_ALL), "/robot/text": (String, DEEP_LATCHED)}
    remapped = ("-r", "/text:=/robot/text", "-r", "a:=/b")
    replay = play(nodes, bag, topics, remapped, regex="/a|/text|/noise", exclude_topics=["/noise"])
    assert replay.of("/b") == in_bag(bag, "/a")
    assert replay.of("/robot/text") == in_bag(bag, "/text")
    assert dict(replay.node.health.sent) == {"/a": 101, "/text": 2}


def test_the_clock_of_the_replay_replaces_a_recorded_clock(nodes, bag):
    topics = {name: TOPICS[name] for name in ("/a", "/clock")}
    replay = play(nodes, bag, topics, clock=50.0, start_offset=0.2, rate=0.4)
    stamps = [deserialize_message(data, Clock).clock for data in replay.of("/clock")]
    times = [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps]
    assert times == sorted(times)
    assert len(set(times)) > 2
    assert BEGIN + 200 * MS <= times[0] <= times[-1] <= BEGIN + 1000 * MS + 3
    assert "/clock" not in replay.node.health.sent


def test_topics_with_unknown_types_or_encodings_are_logged_and_not_sent(nodes, tmp_path, capfd):
    path, kinds = tmp_path / "mixed.mcap", {"/cdr": POINT, "/thing": "my_msgs/msg/Thing"}
    definitions = dict.fromkeys(kinds.values(), bag_makers.definition(POINT))
    with path.open("wb") as stream, bag_makers.mcap_writing(stream, kinds, None, definitions) as (writer, channels):
        for encoding in ("protobuf", "ros1"):
            channels[f"/{encoding}"] = writer.register_channel(f"/{encoding}", encoding, 1)
        for channel in channels.values():
            for index in range(3):
                writer.add_message(channel, BEGIN + index, point(index), BEGIN)
    replay = play(nodes, path, {"/cdr": TOPICS["/a"]})
    assert replay.of("/cdr") == [point(index) for index in range(3)]
    assert dict(replay.node.health.sent) == {"/cdr": 3}
    lines = [line.partition("is not played: ")[2] for line in capfd.readouterr().err.splitlines() if "WARN" in line]
    assert sorted(lines) == [
        "its encoding is protobuf: must be cdr",
        "its encoding is ros1: must be cdr",
        "type my_msgs/msg/Thing is not installed",
    ]
    with pytest.raises(DiffbotError, match=r"no topic of .* can be published"):
        Replay(nodes, path, {}, topics=["/thing"])


def test_a_time_jump_is_logged_and_can_be_skipped_while_waiting(nodes, tmp_path, capfd):
    jump = 56 * 365 * 86400 * 1000 * MS
    messages = [("/a", index * 50 * MS + jump * (index > 4), point(index)) for index in range(10)]
    with Replay(nodes, write_mcap(tmp_path / "run.mcap", messages), {"/a": TOPICS["/a"]}) as replay:
        assert replay.call("resume")[0]
        replay.wait_for("/a", 5)
        (line,) = replay.peer.spin_until(
            lambda: [line for line in capfd.readouterr().err.splitlines() if "WARN" in line], what="the announcement"
        )
        assert "gap of 56.0 years without messages at 0.200 s of the bag" in line
        assert "ros2 param set /replay skip_gaps true" in line
        assert replay.set(skip_gaps=True) == ""
        assert replay.wait_for_end() == 0
    assert replay.of("/a") == [point(index) for index in range(10)]


def test_damage_found_while_playing_is_logged_and_the_exit_status_is_one(nodes, bag, tmp_path, capfd):
    content = bytearray(bag.read_bytes())
    chunks = bag_makers.chunks_of(bag)
    damaged = chunks[len(chunks) // 2]
    content[damaged.chunk_start_offset + damaged.chunk_length // 2] ^= 0x55
    (tmp_path / "damaged.mcap").write_bytes(content)
    with Replay(nodes, tmp_path / "damaged.mcap", {}, start_paused=False, rate=10.0) as replay:
        assert replay.wait_for_end() == 1
    (error,) = [line for line in capfd.readouterr().err.splitlines() if "ERROR" in line]
    assert "damaged.mcap is damaged" in error


def test_an_unexpected_exception_of_the_player_ends_the_replay_as_an_error(nodes, bag, monkeypatch, capfd):
    monkeypatch.setattr(Player, "play", lambda _: 1 // 0)
    with Replay(nodes, bag, {}) as replay:
        assert replay.wait_for_end() == 1
        nodes.peer.spin_until(lambda: replay.reports and replay.reports[-1].message == "error", what="the state")
    assert replay.reports[-1].level == DiagnosticStatus.ERROR
    assert "ZeroDivisionError" in capfd.readouterr().err


def test_parameters_and_services_seek_step_and_change_the_rate(nodes, mapped_bag):
    with Replay(nodes, mapped_bag, MAPPED, clock=50.0) as replay:
        # The same jump twice: to the very message, with the latched one of before it.
        for _ in range(2):
            replay.messages.clear()
            assert replay.set(seek=4.56) == ""
            for _ in range(3):
                assert replay.call("play_next") == (True, "paused")
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
        assert replay.set(rate=1e-6) == ""
        assert replay.call("get_rate") == (True, "1e-06")
        assert replay.call("resume") == (True, "playing")
        assert replay.call("play_next") == (False, "playing")
        # /map comes 1 ns later in the bag, which is 1 ms at this rate; the next /a would come after hours.
        replay.wait_for("/map", 1)
        assert (replay.of("/a"), replay.of("/map")) == (A[:1], MAP[:1])
        assert replay.set(rate=1000.0) == ""
        assert replay.wait_for_end() == 0
    assert (replay.of("/a"), replay.of("/map")) == (A, MAP)


def test_a_type_that_was_recorded_with_another_definition_is_logged():
    node = mock.MagicMock()
    hashes = {"/old": "RIHS01_00", "/same": type_hash(POINT), "/unknown": ""}
    Publications(node, {name: Topic(name, POINT, one) for name, one in hashes.items()}, {})
    (warning,) = node.get_logger().warning.call_args_list
    assert warning.args[0].startswith("/old: subscribers may receive wrong values")


def test_services_of_rosbag2_have_its_names_and_fields_and_work(nodes, mapped_bag, monkeypatch):
    names = ("pause", "resume", "toggle_paused", "is_paused", "get_rate", "set_rate", "play_next", "seek", "stop")
    kinds = {name: "".join(word.capitalize() for word in name.split("_")) for name in names}
    with Replay(nodes, mapped_bag, MAPPED) as replay:
        offered = {}
        monkeypatch.setattr(
            replay.node, "create_service", lambda kind, name, call: offered.update({name: (kind, call)})
        )
        replay.node.offer_rosbag2_services(SimpleNamespace(**{kind: kind for kind in kinds.values()}))
        assert {name: kind for name, (kind, _) in offered.items()} == {
            f"rosbag2_player/{name}": kind for name, kind in kinds.items()
        }

        def call(name, **request):
            return vars(offered[f"rosbag2_player/{name}"][1](SimpleNamespace(**request), SimpleNamespace()))

        assert call("is_paused") == {"paused": True}
        assert call("play_next") == {"success": True}
        assert call("set_rate", rate=2.5) == {"success": True}
        assert call("set_rate", rate=float("nan")) == {"success": False}
        assert call("get_rate") == {"rate": 2.5}
        sec, nanosec = divmod(BEGIN + 420 * MS, 10**9)
        assert call("seek", time=SimpleNamespace(sec=sec, nanosec=nanosec)) == {"success": True}
        assert replay.node._player.progress().bag_time == BEGIN + 420 * MS
        assert call("seek", time=SimpleNamespace(sec=0, nanosec=0)) == {"success": False}
        assert call("resume") == {}
        assert call("is_paused") == {"paused": False}
        assert call("toggle_paused") == {}
        assert call("is_paused") == {"paused": True}
        assert call("stop") == {}
        assert replay.wait_for_end() == 0


def in_terminal(theirs):
    """Return the options of a process whose stdin is this terminal, in its foreground."""
    return {
        "stdin": theirs,
        "start_new_session": True,
        "preexec_fn": lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        "cwd": "/",  # not the source tree, where a program of -c would find the package first
    }


def test_keys_pause_step_and_change_the_rate_and_ctrl_c_restores_the_terminal(mapped_bag):
    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    parameters = {"uri": mapped_bag, "rate": 0.05, "wait_timeout": 60.0}
    with graph.peer() as peer, graph.node("diffbot_bag.replay_node", parameters, **in_terminal(theirs)) as running:
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
        os.write(ours, b"\x1b[A\x1bOA\x1b[B")
        peer.spin_until(lambda: reported("rate") == f"{0.05 * 1.1 * 1.1 * 0.9:g}", what="the rate")
        # One may have been on its way when the pause came.
        assert int(reported("messages")) <= count + 3
        os.write(ours, b"\x03")
        assert running.wait() == 0
    assert termios.tcgetattr(theirs) == before
    os.close(ours)
    os.close(theirs)


def test_merged_bags_are_sent_as_fast_as_subscribers_acknowledge_without_losses(nodes, tmp_path):
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
        qos_profile_overrides_path=str(tmp_path / "qos.yaml"),
    )
    # 400 s of recording; the wait for the end is shorter.
    assert replay.of("/a") == [point(index / 2) for index in range(2000)]
    assert replay.of("/b") == [point(index + 0.5) for index in range(1000)]
