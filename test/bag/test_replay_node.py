"""The replay as a process: bytes, order, count, time and QoS of a bag come back over DDS; a wrong bag is one line."""

import contextlib
import io
import itertools
import math
import re
import signal

import graph
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger

from diffbot_bag.qos import Qos
from diffbot_bag.reader import BagReader
from diffbot_bag.ros_conversions import from_ros, to_ros
from diffbot_bag.writer import BagWriter

pytestmark = pytest.mark.graph

REPLAY = "diffbot_bag.replay_node"
RECORDER = "diffbot_bag.recorder_node"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
DEEP = 10_000
BEGIN = 1_700_000_000_000_000_000
MS = 1_000_000
ATTEMPTS = 4
PATIENCE = 60.0
"""[s] for a process to start, or to play a bag of a second: on a machine without a free core, importing takes 15 s."""


def twist(x):
    message = Twist()
    message.linear.x = float(x)
    return bytes(serialize_message(message))


def string(text):
    # As DDS hands it on: filled up to a multiple of four bytes.
    data = bytes(serialize_message(String(data=text)))
    return data + bytes(-len(data) % 4)


def clock(seconds):
    message = Clock()
    message.clock.sec = seconds
    return bytes(serialize_message(message))


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """One second: /a and /noise at 100 Hz, a latched text at 0 s and 0.3 s, a recorded /clock of 1970."""
    folder = tmp_path_factory.mktemp("bags") / "run"
    writer = BagWriter(folder, chunk_size=2000)
    a = writer.add_topic("/a", "geometry_msgs/msg/Twist", [Qos()])
    noise = writer.add_topic("/noise", "geometry_msgs/msg/Twist", [Qos(reliability="best_effort")])
    text = writer.add_topic("/text", "std_msgs/msg/String", [Qos(durability="transient_local")])
    simulated = writer.add_topic("/clock", "rosgraph_msgs/msg/Clock", [Qos(reliability="best_effort")])
    for index in range(101):
        now = BEGIN + index * 10 * MS
        writer.write(a, twist(index), now, now)
        writer.write(noise, twist(-index), now + 1, now)
        if index in (0, 30):
            writer.write(text, string(f"text at {index}"), now + 2, now)
        if index % 10 == 0:
            writer.write(simulated, clock(index), now + 3, now)
    writer.close()
    return folder


@pytest.fixture
def peer():
    with graph.peer() as running:
        yield running


class Received:
    """What a subscriber of the test received."""

    def __init__(self, peer, *topics):
        self.messages = []
        for topic, message_type, qos in topics:
            peer.node.create_subscription(message_type, topic, self._append(topic), qos, raw=True)

    def _append(self, topic):
        return lambda data: self.messages.append((topic, bytes(data)))

    def of(self, topic):
        return [data for name, data in self.messages if name == topic]


def collect_all(peer):
    return Received(
        peer,
        ("/a", Twist, DEEP),
        ("/noise", Twist, BEST_EFFORT),
        ("/text", String, DEEP),
        ("/clock", Clock, BEST_EFFORT),
    )


def in_bag(folder, topic, start=0.0, end=1.0):
    with BagReader(folder) as reader:
        window = (BEGIN + round(start * 1000) * MS, BEGIN + round(end * 1000) * MS)
        return [message.data for message in reader.messages([topic], *window)]


@contextlib.contextmanager
def replay(folder, parameters=None, arguments=(), **options):
    # Not waiting for acknowledgement at the end: that can take DDS 3 s each time.
    quick = {"uri": folder, "wait_timeout": 10.0, "wait_acked_timeout": -1.0}
    with graph.node(REPLAY, {**quick, **(parameters or {})}, arguments, **options) as running:
        yield running


def ended(running):
    return lambda: running.popen.poll() is not None


def play(peer, folder, parameters=None, arguments=()):
    """Play to the end and hand back the process."""
    with replay(folder, parameters, arguments) as running:
        peer.spin_until(ended(running), PATIENCE, "the end of the replay")
        peer.spin_until_quiet()
        assert running.wait(PATIENCE) == 0, running.output
        return running.output


def duration(output):
    """Return how long [s] a replay says that it sent; when messages are received depends on the test's process, too."""
    return float(re.search(r"messages in ([\d.]+) s", output)[1])


def test_bytes_order_count_and_time_come_back(peer, bag):
    collected = collect_all(peer)
    output = play(peer, bag)
    for topic in ("/a", "/noise", "/text", "/clock"):
        assert collected.of(topic) == in_bag(bag, topic, end=2.0), topic
    assert duration(output) >= 1.0
    assert "215 messages in " in output


@pytest.mark.parametrize("rate", [0.5, 5.0])
def test_the_rate_changes_the_time_alone(peer, bag, rate):
    durations = []
    # Other processes of a busy machine can hold up any one replay, but not each time.
    while len(durations) < ATTEMPTS and min(durations, default=math.inf) > 1.0 / rate + 0.5:
        collected = collect_all(peer)
        durations.append(duration(play(peer, bag, {"rate": rate})))
        assert collected.of("/a") == in_bag(bag, "/a")
        assert durations[-1] >= 1.0 / rate
    assert min(durations) <= 1.0 / rate + 0.5


def test_offset_and_duration_cut_but_the_latched_message_of_before_comes(peer, bag):
    collected = collect_all(peer)
    play(peer, bag, {"start_offset": 0.5, "playback_duration": 0.2})
    assert collected.of("/a") == in_bag(bag, "/a", 0.5, 0.7)
    assert collected.of("/text") == [string("text at 30")]


def test_until_and_topics(peer, bag):
    collected = collect_all(peer)
    play(peer, bag, {"playback_until": BEGIN / 1e9 + 0.25, "topics": ["/a", "/text"]})
    assert (len(collected.of("/a")), len(collected.of("/text"))) == (26, 1)
    assert not collected.of("/noise") + collected.of("/clock")


def test_exclude_regex_and_both_kinds_of_remapping(peer, bag):
    collected = Received(
        peer, ("/b", Twist, DEEP), ("/robot/text", String, DEEP), ("/a", Twist, DEEP), ("/noise", Twist, 10)
    )
    parameters = {"regex": "/a|/text|/noise", "exclude_topics": ["/noise"], "remap": ["a:=/b"], "rate": 10.0}
    play(peer, bag, parameters, ("-r", "/text:=/robot/text"))
    assert collected.of("/b") == in_bag(bag, "/a")
    assert collected.of("/robot/text") == in_bag(bag, "/text")
    assert not collected.of("/a") + collected.of("/noise")


def test_a_loop_goes_on_until_a_signal(peer, bag):
    collected = collect_all(peer)
    with replay(bag, {"loop": True, "playback_duration": 0.1, "rate": 2.0}) as running:
        peer.spin_until(lambda: len(collected.of("/a")) >= 40, timeout=PATIENCE, what="four rounds")
        assert running.stop(signal.SIGTERM) == 0
    one = in_bag(bag, "/a", 0.0, 0.1)
    assert collected.of("/a")[:33] == one * 3


def test_the_clock_replaces_a_recorded_one(peer, bag):
    collected = collect_all(peer)
    play(peer, bag, {"clock": 50.0, "start_offset": 0.2})
    stamps = [deserialize_message(data, Clock).clock for data in collected.of("/clock")]
    times = [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps]
    assert BEGIN + 200 * MS <= times[0] < BEGIN + 350 * MS
    assert times == sorted(times)
    assert times[-1] > BEGIN + 900 * MS
    assert len(times) > 25
    assert collected.of("/a") == in_bag(bag, "/a", 0.2)


def test_publishers_offer_the_recorded_qos(peer, bag):
    with replay(bag, {"start_paused": True, "wait_timeout": 0.0}):
        infos = {}

        def seen():
            infos.update({name: peer.node.get_publishers_info_by_topic(name) for name in ("/a", "/noise", "/text")})
            return all(infos.values())

        peer.spin_until(seen, PATIENCE, "publishers")
        offered = {name: from_ros(info[0].qos_profile) for name, info in infos.items()}
    assert (offered["/a"].reliability, offered["/a"].durability) == ("reliable", "volatile")
    assert (offered["/noise"].reliability, offered["/noise"].durability) == ("best_effort", "volatile")
    assert (offered["/text"].reliability, offered["/text"].durability) == ("reliable", "transient_local")


def test_a_latecomer_gets_the_latched_message(peer, bag):
    with replay(bag, {"rate": 20.0, "loop": True, "delay": 0.3, "wait_timeout": 0.0}) as running:
        running.wait_for_output("ready", PATIENCE)
        reports = peer.subscribe(DiagnosticStatus, "/replay/status", LATCHED)
        peer.spin_until(lambda: reports and int(graph.values(reports[-1])["messages"]) >= 200, PATIENCE, "a round")
        collected = Received(peer, ("/text", String, LATCHED))
        peer.spin_until(lambda: collected.of("/text"), what="the latched message")
    assert collected.of("/text")[0] in (string("text at 0"), string("text at 30"))


def test_services_pause_step_resume_and_stop(peer, bag):
    collected = collect_all(peer)

    def call(name):
        return peer.call(Trigger, f"/replay/{name}")

    with replay(bag, {"start_paused": True, "topics": ["/a"]}) as running:
        assert (call("is_paused").success, call("is_paused").message) == (True, "paused")
        # It first waits for its subscriber, which is here: the step is possible from then on.
        peer.spin_until(lambda: call("play_next").success, what="a step")
        assert call("play_next").success
        peer.spin_until(lambda: len(collected.of("/a")) >= 2, what="two steps")
        assert collected.of("/a") == in_bag(bag, "/a")[:2]
        assert call("toggle_paused").message == "playing"
        peer.spin_until(lambda: len(collected.of("/a")) > 10, what="messages after the pause")
        assert call("pause").success
        assert call("is_paused").message == "paused"
        peer.spin_for(0.05)
        count = len(collected.of("/a"))
        reports = peer.subscribe(DiagnosticStatus, "/replay/status", LATCHED)
        peer.spin_until(lambda: reports and reports[-1].message == "paused", what="paused in ~/status")
        peer.spin_for(0.2)
        assert len(collected.of("/a")) == count
        values = graph.values(reports[-1])
        assert values["uri"] == str(bag)
        assert float(values["progress"]) == pytest.approx(count / 100, abs=0.03)
        assert call("resume").message == "playing"
        assert not call("play_next").success
        peer.spin_until(lambda: len(collected.of("/a")) > count, what="messages after the second pause")
        assert call("stop").success
        assert running.wait(PATIENCE) == 0
    assert collected.of("/a") == in_bag(bag, "/a")[: len(collected.of("/a"))]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_at_once_even_in_a_long_gap(tmp_path, number):
    writer = BagWriter(tmp_path / "run")
    channel = writer.add_topic("/a", "geometry_msgs/msg/Twist", [Qos()])
    writer.write(channel, twist(0), BEGIN, BEGIN)
    writer.write(channel, twist(1), BEGIN + 3600 * 10**9, BEGIN)
    writer.close()
    with graph.node(REPLAY, {"uri": tmp_path / "run", "wait_timeout": 0.0}) as running:
        running.wait_for_output("ready", PATIENCE)
        assert running.stop(number, timeout=3.0) == 0


def test_the_end_waits_until_subscribers_have_everything(peer, bag):
    Received(peer, ("/a", Twist, DEEP))
    quick = {"topics": ["/a"], "rate": 20.0}
    assert "not acknowledged" not in play(peer, bag, {**quick, "wait_acked_timeout": 20.0})


def test_waiting_for_named_topics_is_said_and_ends(bag):
    parameters = {"wait_for_topics": ["/a", "/none"], "wait_timeout": 0.3, "rate": 20.0}
    with graph.node(REPLAY, {"uri": bag, **parameters}) as running:
        assert running.wait(PATIENCE) == 0
        assert "no subscriber after 0.3 s: /a" in running.output
        assert "wait_for_topics that are not played are ignored: /none" in running.output


def test_a_type_that_is_not_installed_is_said_and_the_rest_played(peer, tmp_path):
    writer = BagWriter(tmp_path / "run")
    a = writer.add_topic("/a", "geometry_msgs/msg/Twist", [Qos()])
    b = writer.add_topic("/b", "my_msgs/msg/Thing", [Qos()])
    for index in range(5):
        writer.write(a, twist(index), BEGIN + index, BEGIN)
        writer.write(b, b"\0\1\0\0", BEGIN + index, BEGIN)
    writer.close()
    collected = Received(peer, ("/a", Twist, DEEP))
    output = play(peer, tmp_path / "run")
    assert output.count("/b is not played: type my_msgs/msg/Thing is not installed") == 1
    assert len(collected.of("/a")) == 5
    with graph.node(REPLAY, {"uri": tmp_path / "run", "topics": ["/b"]}) as running:
        assert running.wait(PATIENCE) == 1
        assert "can be published" in running.output


def test_an_unfinished_bag_is_played_up_to_its_end_with_one_warning(bag, peer, tmp_path):
    whole = (bag / "run_0.mcap").read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: len(whole) * 2 // 3])
    collected = Received(peer, ("/a", Twist, DEEP))
    output = play(peer, path, {"topics": ["/a"], "rate": 2.0})
    (warning,) = [line for line in output.splitlines() if "WARN" in line]
    assert "cut.mcap is unfinished: cut.mcap has no index, and the last" in warning
    found = collected.of("/a")
    assert found == [twist(index) for index in range(len(found))]
    with path.open("rb") as stream, contextlib.suppress(Exception):
        expected = 0
        for record in StreamReader(stream).records:
            expected += isinstance(record, Message) and record.channel_id == 1
    assert len(found) == expected > 30


def test_every_wrong_bag_is_one_line_and_status_one(bag, tmp_path):
    whole = (bag / "run_0.mcap").read_bytes()
    (tmp_path / "flipped.mcap").write_bytes(whole[:1000] + bytes(50) + whole[1050:-100])
    (tmp_path / "foreign.mcap").write_bytes(bytes(range(256)) * 20)
    (tmp_path / "empty").mkdir()
    BagWriter(tmp_path / "silent").close()
    cases = {
        "none": "no such file or folder",
        "flipped.mcap": "`diffbot bag repair` saves what is intact",
        "foreign.mcap": "is not an MCAP file",
        "empty": "neither metadata.yaml nor an MCAP file",
        "silent": "has no message to play",
    }
    with contextlib.ExitStack() as stack:
        running = {
            name: stack.enter_context(graph.node(REPLAY, {"uri": tmp_path / name, "rate": 10.0})) for name in cases
        }
        for name, words in cases.items():
            assert running[name].wait(PATIENCE) == 1
            (line,) = running[name].output.splitlines()
            assert line.startswith("error: ")
            assert words in line


def test_wrong_parameters_are_one_line_and_status_one(bag):
    cases = [
        ({}, "uri = '': must be the folder of a bag or an MCAP file"),
        ({"uri": bag, "rate": 0.0}, "rate = 0.0: must be >= 1e-06 and <= 1e+06"),
        ({"uri": bag, "rate": 5e-324}, "rate = 5e-324: must be >= 1e-06"),
        ({"uri": bag, "start_offset": 5.0}, "start_offset = 5.0: must be <= 1 s, the bag's length"),
        ({"uri": bag, "remap": ["a"]}, "remap = 'a': must be old:=new"),
    ]
    with contextlib.ExitStack() as stack:
        running = [stack.enter_context(graph.node(REPLAY, parameters)) for parameters, _ in cases]
        for process, (_, words) in zip(running, cases, strict=True):
            assert process.wait(PATIENCE) == 1
            (line,) = process.output.splitlines()
            assert words in line


def test_damage_found_while_playing_is_one_line_and_status_one(bag, tmp_path):
    content = bytearray((bag / "run_0.mcap").read_bytes())
    chunks = make_reader(io.BytesIO(content)).get_summary().chunk_indexes
    damaged = chunks[len(chunks) // 2]
    content[damaged.chunk_start_offset + damaged.chunk_length // 2] ^= 0x55
    (tmp_path / "damaged.mcap").write_bytes(content)
    with graph.node(REPLAY, {"uri": tmp_path / "damaged.mcap", "rate": 10.0, "wait_timeout": 0.0}) as running:
        assert running.wait(PATIENCE) == 1
        errors = [line for line in running.output.splitlines() if "ERROR" in line]
        assert len(errors) == 1
        assert "damaged.mcap is damaged" in errors[0]
        assert "Traceback" not in running.output


def test_a_bag_recorded_from_its_own_replay_is_the_same(bag, tmp_path):
    with graph.node(RECORDER, {"uri": tmp_path / "copy", "topics": ["/a", "/noise", "/text"]}) as recorder:
        recorder.wait_for_output("ready", PATIENCE)
        parameters = {"uri": bag, "topics": ["/a", "/noise", "/text"], "rate": 2.0, "wait_timeout": 10.0}
        with graph.node(REPLAY, parameters) as running:
            assert running.wait(PATIENCE) == 0
        assert recorder.stop() == 0
        assert " 0 lost" in recorder.output
    for topic in ("/a", "/noise", "/text"):
        assert in_bag(bag, topic, end=2.0) == copied(tmp_path / "copy", topic), topic
    with BagReader(bag) as one, BagReader(tmp_path / "copy") as two:
        times = [[message.log_time for message in reader.messages(["/a"])] for reader in (one, two)]
        assert [topic.type_hash for topic in one.topics.values()][:3] == [
            two.topics[name].type_hash for name in ("/a", "/noise", "/text")
        ]
    steps = [after - before for before, after in itertools.pairwise(times[1])]
    assert sorted(steps)[50] == pytest.approx(5 * MS, abs=3 * MS)


def copied(folder, topic):
    with BagReader(folder) as reader:
        return [message.data for message in reader.messages([topic])]


@pytest.mark.parametrize(
    "qos",
    [
        Qos("keep_last", 1),
        Qos("keep_last", 7, "best_effort", "volatile", 5 * MS, 9 * MS, "manual_by_topic", 20 * MS, True),
        Qos("keep_last", 3, "reliable", "transient_local"),
    ],
)
def test_qos_survives_the_way_to_ros_and_back(qos):
    assert from_ros(to_ros(qos)) == qos
