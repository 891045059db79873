"""The replay: bytes, order, count and QoS of bags come back over DDS, controlled by parameters and services."""

import io
import re

import pytest
from bag_makers import BEGIN, MS, POINT, STRING, point, string, write_mcap
from geometry_msgs.msg import Point
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message, serialize_message
from recorders import BEST_EFFORT, DEEP_LATCHED, KEEP_ALL
from replay_nodes import Replay, play
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from diffbot_bag.bag.qos import Qos
from diffbot_bag.bag.reader import BagReader
from diffbot_bag.bag.writer import BagWriter
from diffbot_bag.ros.conversions import from_ros
from diffbot_core.errors import DiffbotError

pytestmark = pytest.mark.graph

TOPICS = {
    "/a": (Point, KEEP_ALL),
    "/noise": (Point, BEST_EFFORT),
    "/text": (String, DEEP_LATCHED),
    "/clock": (Clock, BEST_EFFORT),
}


def clock(seconds):
    message = Clock()
    message.clock.sec = seconds
    return bytes(serialize_message(message))


def write_bag(folder, topics, messages):
    writer = BagWriter(folder, chunk_size=2000)
    channels = {name: writer.add_topic(name, kind, [qos]) for name, (kind, qos) in topics.items()}
    for topic, time, data in messages:
        writer.write(channels[topic], data, time, time)
    writer.close()
    return folder


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """One second: /a and /noise at 100 Hz, a latched text at 0 s and 0.3 s, a recorded /clock of 1970."""
    topics = {
        "/a": (POINT, Qos()),
        "/noise": (POINT, Qos(reliability="best_effort")),
        "/text": (STRING, Qos(durability="transient_local")),
        "/clock": ("rosgraph_msgs/msg/Clock", Qos(reliability="best_effort")),
    }
    times = [BEGIN + index * 10 * MS for index in range(101)]
    messages = [("/a", time, point(index)) for index, time in enumerate(times)]
    messages += [("/noise", time + 1, point(-index)) for index, time in enumerate(times)]
    messages += [("/text", times[index] + 2, string(f"text at {index}")) for index in (0, 30)]
    messages += [("/clock", times[index] + 3, clock(index)) for index in range(0, 101, 10)]
    messages.sort(key=lambda message: message[1])
    return write_bag(tmp_path_factory.mktemp("bags") / "run", topics, messages)


def in_bag(folder, topic, start=0.0, end=2.0):
    with BagReader(folder) as reader:
        window = (BEGIN + round(start * 1000) * MS, BEGIN + round(end * 1000) * MS)
        return [message.data for message in reader.messages([topic], *window)]


def in_order(part, whole):
    """Whether all of ``part`` is in ``whole``, once and in the same order."""
    rest = iter(whole)
    return all(one in rest for one in part)


def test_bytes_order_and_count_come_back(nodes, bag, capfd):
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
    assert "not acknowledged" not in output


def test_offset_duration_and_rate_but_the_latched_message_of_before_comes(nodes, bag, capfd):
    replay = play(nodes, bag, TOPICS, start_offset=0.5, playback_duration=0.2, rate=0.5)
    assert replay.of("/a") == in_bag(bag, "/a", 0.5, 0.7)
    assert replay.of("/text") == [string("text at 30")]
    # A busy machine takes longer, but none is faster.
    assert float(re.search(r"messages in ([\d.]+) s", capfd.readouterr().err)[1]) >= 0.4


def test_until_selection_and_both_kinds_of_remapping(nodes, bag):
    topics = {"/b": (Point, KEEP_ALL), "/robot/text": (String, DEEP_LATCHED)}
    replay = play(
        nodes,
        bag,
        topics,
        ("-r", "/text:=/robot/text"),
        regex="/a|/text|/noise",
        exclude_topics=["/noise"],
        remap=["a:=/b"],
        wait_for_topics=["/a", "/text"],
        playback_until=BEGIN / 1e9 + 0.25,
    )
    assert replay.of("/b") == in_bag(bag, "/a", 0.0, 0.25)
    assert replay.of("/robot/text") == [string("text at 0")]
    assert dict(replay.node.health.sent) == {"/a": 26, "/text": 1}


def test_the_clock_replaces_a_recorded_one(nodes, bag):
    topics = {name: TOPICS[name] for name in ("/a", "/clock")}
    replay = play(nodes, bag, topics, wait_for_topics=["/a"], clock=50.0, start_offset=0.2, rate=0.4)
    stamps = [deserialize_message(data, Clock).clock for data in replay.of("/clock")]
    times = [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps]
    assert times == sorted(times)
    assert len(set(times)) > 2
    assert BEGIN + 200 * MS <= times[0] <= times[-1] <= BEGIN + 1000 * MS + 3
    assert "/clock" not in replay.node.health.sent


def test_the_recorded_qos_is_offered_or_the_one_of_a_file(nodes, bag, tmp_path):
    path, names = tmp_path / "qos.yaml", ("/a", "/noise", "/text")
    path.write_text("/a: {reliability: best_effort, deadline: {sec: 2, nsec: 0}}\n")
    find = nodes.peer.node.get_publishers_info_by_topic
    with Replay(nodes, bag, {}, qos_profile_overrides_path=str(path)):
        nodes.peer.spin_until(lambda: all(map(find, names)), what="publishers")
        a, noise, text = (from_ros(find(name)[0].qos_profile) for name in names)
    assert (a.reliability, a.durability, a.deadline) == ("best_effort", "volatile", 2 * 10**9)
    assert (noise.reliability, noise.durability) == ("best_effort", "volatile")
    assert (text.reliability, text.durability) == ("reliable", "transient_local")


def test_a_type_that_is_not_installed_is_named_once_and_the_rest_played(nodes, tmp_path, capfd):
    topics = {"/a": (POINT, Qos()), "/b": ("my_msgs/msg/Thing", Qos())}
    messages = [(topic, BEGIN + index, point(index)) for index in range(5) for topic in topics]
    run = write_bag(tmp_path / "run", topics, messages)
    replay = play(nodes, run, {"/a": TOPICS["/a"]})
    assert capfd.readouterr().err.count("/b is not played: type my_msgs/msg/Thing is not installed") == 1
    assert replay.of("/a") == [point(index) for index in range(5)]
    with pytest.raises(DiffbotError, match=r"no topic of .* can be published"):
        Replay(nodes, run, {}, topics=["/b"])


def test_damage_found_while_playing_is_one_line_and_status_one(nodes, bag, tmp_path, capfd):
    content = bytearray((bag / "run_0.mcap").read_bytes())
    chunks = make_reader(io.BytesIO(content)).get_summary().chunk_indexes
    damaged = chunks[len(chunks) // 2]
    content[damaged.chunk_start_offset + damaged.chunk_length // 2] ^= 0x55
    (tmp_path / "damaged.mcap").write_bytes(content)
    with Replay(nodes, tmp_path / "damaged.mcap", {}, start_paused=False, wait_timeout=0.0, rate=10.0) as replay:
        assert replay.wait_for_end() == 1
    (error,) = [line for line in capfd.readouterr().err.splitlines() if "ERROR" in line]
    assert "damaged.mcap is damaged" in error


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"uri": ""}, "uri = '': must be the folder of a bag or an MCAP file"),
        ({"uri": "silent"}, "has no message to play"),
        ({"bags": ["other.mcap"]}, "/a is geometry_msgs/msg/Point in"),
        ({"remap": ["a"]}, "remap = 'a': must be old:=new"),
        ({"burst": 3, "start_paused": False}, "burst = 3: must be 0, unless start_paused is true"),
        ({"qos_profile_overrides_path": "qos.yaml"}, "/a: not a QoS profile: {"),
    ],
)
def test_what_it_refuses_to_start_with(nodes, bag, tmp_path, monkeypatch, parameters, words):
    monkeypatch.chdir(tmp_path)
    BagWriter(tmp_path / "silent").close()
    write_mcap(tmp_path / "other.mcap", [("/a", BEGIN, string(""))], STRING)
    (tmp_path / "qos.yaml").write_text("/a: {depth: none}\n")
    with pytest.raises(DiffbotError, match=re.escape(words)):
        Replay(nodes, parameters.pop("uri", bag), {}, **parameters)
