"""The recorder as a process: what was published over DDS is in the bag, to the byte and in order, however it ends."""

import contextlib
import itertools
import re
import resource
import signal
import struct
import sys

import graph
import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from diffbot_bag import metadata
from diffbot_bag.reader import BagReader
from diffbot_bag.recorder_node import RecorderNode

pytestmark = pytest.mark.graph

RECORDER = "diffbot_bag.recorder_node"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
DEEP = 10_000


@contextlib.contextmanager
def recorder(folder, parameters=None, arguments=(), **options):
    with graph.node(RECORDER, {"uri": folder, **(parameters or {})}, arguments, **options) as running:
        running.wait_for_output("ready")
        yield running


def wait_until_recorded(peer, *publishers):
    """Wait until the recorder reports these topics as subscribed."""
    reports = peer.subscribe(DiagnosticStatus, "/recorder/status", LATCHED)
    expected_topics = {publisher.topic_name for publisher in publishers}
    peer.spin_until(
        lambda: reports and expected_topics <= set(graph.values(reports[-1])["topics"].split()),
        what=f"{expected_topics} in ~/status",
    )
    return reports


def twists(count):
    message = Twist()
    for index in range(count):
        message.linear.x = index / 7
        yield message


def publish(publisher, messages):
    """Publish and return the bytes, serialized by ROS and apart from the recorder."""
    sent = []
    for message in messages:
        data = bytes(serialize_message(message))
        # DDS fills up to a multiple of four bytes.
        sent.append(data + bytes(-len(data) % 4))
        publisher.publish(message)
    return sent


def wait_until_arrived(publisher):
    """Wait until DDS has delivered everything; on a busy machine it drops and, up to 3 s later, repeats."""
    assert publisher.wait_for_all_acked(Duration(seconds=20))


def recorded(folder, topic):
    """Bytes of a topic as rosbags reads them."""
    with AnyReader([folder]) as reader:
        chosen = [connection for connection in reader.connections if connection.topic == topic]
        return [bytes(data) for _, _, data in reader.messages(chosen)]


def whole_records(path):
    """Records of a file that may have no end."""
    with path.open("rb") as stream, contextlib.suppress(EndOfFile, struct.error):
        yield from StreamReader(stream).records


@pytest.fixture
def peer():
    with graph.peer() as running:
        yield running


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_burst_of_5000_is_recorded_to_the_byte_whatever_signal_ends_it(tmp_path, peer, number):
    reliable = peer.publisher(Twist, "burst", DEEP)
    with recorder(tmp_path / "run") as running:
        wait_until_recorded(peer, reliable)
        sent = publish(reliable, twists(5000))
        wait_until_arrived(reliable)
        assert running.stop(number) == 0
        assert f"0 lost, {tmp_path / 'run'}" in running.output
    assert recorded(tmp_path / "run", "/burst") == sent
    custom = metadata.read(tmp_path / "run").custom_data
    assert custom == {"lost_messages": "0"}


def test_what_waits_for_its_turn_at_the_end_is_recorded(tmp_path, peer):
    publisher = peer.publisher(Twist, "waiting", QoSProfile(depth=100))
    rclpy.init(args=["--ros-args", "-p", f"uri:={tmp_path / 'run'}", "-p", "topics:=[/waiting]"])
    try:
        # It finds the topic by itself but is never given the time to take a message.
        node = RecorderNode()
        graph.wait_for(lambda: node.count_publishers("/waiting"), what="the publisher in the graph")
        node.update_subscriptions()
        peer.wait_for_subscribers(publisher)
        sent = publish(publisher, twists(100))
        wait_until_arrived(publisher)
        node.before_shutdown()
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    assert recorded(tmp_path / "run", "/waiting") == sent


def test_topics_qos_hashes_and_times_are_recorded(tmp_path, peer):
    latched = peer.publisher(String, "description", LATCHED)
    before = publish(latched, [String(data="<robot/>")])
    with recorder(tmp_path / "run") as running:
        unreliable = peer.publisher(Twist, "/deep/noise", BEST_EFFORT)
        reports = wait_until_recorded(peer, unreliable, latched)
        start = peer.node.get_clock().now().nanoseconds
        sent = publish(unreliable, twists(20))
        end = peer.node.get_clock().now().nanoseconds
        peer.spin_until(lambda: count(reports) >= 21, what="all messages")
        assert running.stop() == 0
    assert recorded(tmp_path / "run", "/description") == before
    assert recorded(tmp_path / "run", "/deep/noise") == sent
    (info,) = peer.node.get_publishers_info_by_topic("/deep/noise")
    with BagReader(tmp_path / "run") as reader:
        topics = reader.topics
        times = [(m.publish_time, m.log_time) for m in reader.messages(["/deep/noise"])]
    assert topics["/deep/noise"].type_hash == str(info.topic_type_hash)
    assert topics["/deep/noise"].qos[0].reliability == "best_effort"
    assert topics["/description"].qos[0].durability == "transient_local"
    assert all(start <= published <= end for published, _ in times)
    assert all(published < received < published + 5 * 10**9 for published, received in times)
    assert times == sorted(times)
    # rosbag2's default: what belongs to the graph itself is recorded, too. The recorder's own status is not.
    assert {"/rosout", "/parameter_events"} <= set(topics)
    assert "/recorder/status" not in topics


def test_mixed_qos_on_one_topic_is_recorded_from_all(tmp_path, peer):
    mixed = [
        peer.publisher(Twist, "mixed", qos)
        for qos in (
            QoSProfile(depth=100),
            BEST_EFFORT,
            QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL),
        )
    ]
    with recorder(tmp_path / "run") as running:
        peer.wait_for_subscribers(*mixed)
        reports = wait_until_recorded(peer, mixed[0])
        sent = [publish(publisher, twists(10)) for publisher in mixed]
        peer.spin_until(lambda: count(reports) >= 30, what="all messages")
        assert running.stop() == 0
        assert " 0 lost" in running.output
    assert sorted(recorded(tmp_path / "run", "/mixed")) == sorted(itertools.chain(*sent))
    with BagReader(tmp_path / "run") as reader:
        assert len(reader.topics["/mixed"].qos) == 3


def test_selection_and_namespace(tmp_path, peer):
    publishers = [peer.publisher(Twist, name) for name in ("/robot/a", "/robot/b", "/other", "/_hidden")]
    parameters = {"topics": ["a", "/_hidden", "/never"], "regex": "/o.*", "exclude_topics": ["b"]}
    with recorder(tmp_path / "run", parameters, ("-r", "__ns:=/robot", "-r", "__node:=box")) as running:
        peer.wait_for_subscribers(publishers[0], publishers[2], publishers[3])
        assert publishers[1].get_subscription_count() == 0
        assert running.stop() == 0
    assert {topic.name for topic in metadata.read(tmp_path / "run").topics} == {"/robot/a", "/other", "/_hidden"}


def test_hidden_topics_are_left_out_by_default(tmp_path, peer):
    hidden, visible = peer.publisher(Twist, "/a/_b/c"), peer.publisher(Twist, "/a/b/c")
    with recorder(tmp_path / "run") as running:
        wait_until_recorded(peer, visible)
        assert hidden.get_subscription_count() == 0
        assert running.stop() == 0


def test_lost_messages_are_counted_told_and_kept(tmp_path, peer):
    publisher = peer.publisher(Twist, "noise", BEST_EFFORT)
    with recorder(tmp_path / "run", {"depth": 5, "topics": ["/noise"]}) as running:
        reports = wait_until_recorded(peer, publisher)
        health = peer.subscribe(DiagnosticArray, "/diagnostics", 100)
        # A loss is detected between two messages: this is the first.
        publish(publisher, twists(1))
        peer.spin_until(lambda: count(reports) == 1, what="the first message")
        # A recorder that does not run cannot take anything; its queue holds the newest five.
        running.send(signal.SIGSTOP)
        publish(publisher, twists(50))
        running.send(signal.SIGCONT)
        # What was dropped shows with the next message that is not.
        later = []
        peer.spin_until(
            lambda: later.extend(publish(publisher, twists(1))) or graph.values(reports[-1])["lost"] != "0",
            what="lost messages in ~/status",
        )
        assert reports[-1].level == DiagnosticStatus.WARN
        lost = graph.values(reports[-1])["lost"]
        peer.spin_until(
            lambda: any(graph.values(s).get("/noise dropped: lost") == lost for a in health for s in a.status),
            what="lost messages in /diagnostics",
        )
        assert running.stop() == 0
        assert f", {lost} lost, " in running.output
    assert metadata.read(tmp_path / "run").custom_data == {"lost_messages": lost, "lost /noise": lost}
    assert len(recorded(tmp_path / "run", "/noise")) == 51 + len(later) - int(lost)


def test_what_a_node_of_simulated_time_records(tmp_path, peer):
    clock, data = peer.publisher(Clock, "/clock"), peer.publisher(Twist, "data", 100)
    with recorder(tmp_path / "run", {"use_sim_time": True}) as running:
        reports = wait_until_recorded(peer, data)
        assert reports[-1].message == "waiting for /clock"
        early = publish(data, twists(3))
        peer.spin_until(lambda: int(graph.values(reports[-1])["held"]) >= 3, what="held messages")
        tick(clock, 500)
        peer.spin_until(lambda: reports[-1].message == "recording", what="recording")
        tick(clock, 900)
        # /clock and /data are not ordered among each other: the recorder has both only when it says so.
        before = count(reports)
        peer.spin_until(lambda: count(reports) > before, what="/clock in the bag")
        later = publish(data, twists(5))
        wait_until_arrived(data)
        assert running.stop() == 0
    with BagReader(tmp_path / "run") as reader:
        messages = list(reader.messages(["/data"]))
        first = reader.start
    assert [message.data for message in messages] == early + later
    assert {message.log_time for message in messages[:3]} == {500 * 10**9}
    assert {message.log_time for message in messages[3:]} == {900 * 10**9}
    assert first == 500 * 10**9


def tick(clock, seconds):
    message = Clock()
    message.clock.sec = seconds
    clock.publish(message)


def count(reports):
    return int(graph.values(reports[-1])["messages"])


def test_without_a_clock_messages_keep_the_time_of_reception(tmp_path, peer):
    data = peer.publisher(Twist, "data", 100)
    with recorder(tmp_path / "run", {"use_sim_time": True, "max_held": 5, "topics": ["/data"]}) as running:
        wait_until_recorded(peer, data)
        start = peer.node.get_clock().now().nanoseconds
        sent = publish(data, twists(8))
        wait_until_arrived(data)
        assert running.stop() == 0
        assert "no /clock received: 5 messages keep their time of reception" in running.output
    assert recorded(tmp_path / "run", "/data") == sent[:5]
    with BagReader(tmp_path / "run") as reader:
        assert reader.start >= start


def test_a_killed_recorder_loses_at_most_one_flush_period(tmp_path, peer):
    publisher = peer.publisher(Twist, "data", DEEP)
    with recorder(tmp_path / "run", {"flush_period": 0.3, "topics": ["/data"]}) as running:
        reports = wait_until_recorded(peer, publisher)
        sent = publish(publisher, twists(500))
        peer.spin_until(lambda: count(reports) >= 500, what="500 messages")
        path = tmp_path / "run" / "run_0.mcap"
        # One flush later they are on the disk; the process gets no chance to add anything.
        graph.wait_for(lambda: len([r for r in whole_records(path) if isinstance(r, Message)]) == 500, 3.0, "a flush")
        publish(publisher, twists(10))
        running.popen.kill()
        running.wait()
    records = list(whole_records(path))
    data = [record.data for record in records if isinstance(record, Message)]
    assert data[:500] == sent
    assert [record.topic for record in records if isinstance(record, Channel)] == ["/data"]
    assert not (tmp_path / "run" / "metadata.yaml").exists()


def test_a_second_signal_does_not_cut_the_end_short(tmp_path, peer):
    publisher = peer.publisher(Twist, "data", DEEP)
    with recorder(tmp_path / "run", {"depth": 20_000}) as running:
        wait_until_recorded(peer, publisher)
        sent = publish(publisher, twists(5000))
        wait_until_arrived(publisher)
        for number in (signal.SIGINT, signal.SIGINT, signal.SIGTERM):
            running.send(number)
        with contextlib.suppress(ProcessLookupError):
            while running.popen.poll() is None:
                running.send(signal.SIGINT)
        assert running.wait() == 0
    assert recorded(tmp_path / "run", "/data") == sent
    assert yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())


@pytest.mark.parametrize("where", ["taken", "file/run", "/proc/none/run"])
def test_a_folder_that_cannot_be_made_is_one_line_before_anything_is_recorded(tmp_path, where):
    (tmp_path / "taken").mkdir()
    (tmp_path / "file").write_text("")
    with graph.node(RECORDER, {"uri": tmp_path / where}) as running:
        assert running.wait() == 1
        (line,) = running.output.splitlines()
        assert line.startswith("error: ")
        assert "exists already" in line if where == "taken" else "cannot create the bag" in line
    assert not list((tmp_path / "taken").iterdir())


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"depth": 0}, "depth = 0: must be"),
        ({"compression": "gzip"}, "compression = 'gzip': must be one of zstd, lz4, none"),
        ({"regex": "("}, "regex = '(': must be a regular expression"),
    ],
)
def test_a_wrong_parameter_is_one_line_and_no_folder(tmp_path, parameters, words):
    with graph.node(RECORDER, {"uri": tmp_path / "run", **parameters}) as running:
        assert running.wait() == 1
        (line,) = running.output.splitlines()
        assert line.startswith("error: ")
        assert words in line
    assert not (tmp_path / "run").exists()


def test_the_default_name_is_that_of_rosbag2(tmp_path):
    with graph.node(RECORDER, cwd=tmp_path) as running:
        running.wait_for_output("ready")
        assert running.stop() == 0
    (folder,) = tmp_path.iterdir()
    assert re.fullmatch(r"rosbag2_\d{4}(_\d\d){2}-\d\d(_\d\d){2}", folder.name)
    assert (folder / f"{folder.name}_0.mcap").is_file()


def test_a_full_disk_ends_the_recorder_with_one_line_and_a_readable_bag(tmp_path, peer):
    publisher = peer.publisher(Twist, "data", DEEP)
    limit = 60_000
    with recorder(
        tmp_path / "run",
        {"compression": "none", "chunk_size": 4096, "topics": ["/data"], "flush_period": 0.1},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        env=graph.environment(ROS_LOG_DIR=str(tmp_path / "log")),
    ) as running:
        wait_until_recorded(peer, publisher)
        sent = publish(publisher, twists(5000))
        assert running.wait() == 1
        errors = [line for line in running.output.splitlines() if "ERROR" in line]
        assert len(errors) == 1
        assert "run_0.mcap: File too large; the bag ends after about" in errors[0]
        assert "Traceback" not in running.output
    data = [record.data for record in whole_records(tmp_path / "run" / "run_0.mcap") if isinstance(record, Message)]
    assert data == sent[: len(data)]
    assert len(data) > 200


HIDE_A_TYPE = """
import sys
import geometry_msgs.msg
del geometry_msgs.msg.TwistStamped
from diffbot_bag.recorder_node import main
sys.exit(main())
"""


def test_a_type_that_is_not_installed_is_said_once_and_not_fatal(tmp_path, peer):
    good, foreign = peer.publisher(Twist, "good"), peer.publisher(TwistStamped, "foreign")
    parameters = ["-p", f"uri:={tmp_path / 'run'}", "-p", "topic_polling_interval:=0.02"]
    with graph.process(sys.executable, "-c", HIDE_A_TYPE, "--ros-args", *parameters) as running:
        running.wait_for_output(
            "/foreign is not recorded: it has a type that cannot be loaded: type geometry_msgs/msg/"
        )
        wait_until_recorded(peer, good)
        sent = publish(good, twists(3))
        wait_until_arrived(good)
        assert foreign.get_subscription_count() == 0
        assert running.stop() == 0
        assert running.output.count("/foreign is not recorded") == 1
    assert recorded(tmp_path / "run", "/good") == sent


# The order in which two types are discovered is random; here both are present from the start.
TWO_TYPES = """
import sys
from diffbot_bag.recorder_node import RecorderNode, main
original = RecorderNode.get_topic_names_and_types
RecorderNode.get_topic_names_and_types = lambda node: [
    (name, [*types, "std_msgs/msg/String"] if name == "/odd" else types) for name, types in original(node)
]
sys.exit(main())
"""


def test_a_topic_of_two_types_is_said_once_and_left_out(tmp_path, peer):
    good, odd = peer.publisher(Twist, "good"), peer.publisher(Twist, "odd")
    parameters = ["-p", f"uri:={tmp_path / 'run'}", "-p", "topic_polling_interval:=0.02"]
    with graph.process(sys.executable, "-c", TWO_TYPES, "--ros-args", *parameters) as running:
        running.wait_for_output(
            "/odd is not recorded: it has several types (geometry_msgs/msg/Twist, std_msgs/msg/String)"
        )
        wait_until_recorded(peer, good)
        assert odd.get_subscription_count() == 0
        assert running.stop() == 0
        assert running.output.count("/odd is not recorded") == 1


def test_keep_all_publishers_do_not_disturb(tmp_path, peer):
    publisher = peer.publisher(Twist, "all", QoSProfile(history=HistoryPolicy.KEEP_ALL))
    with recorder(tmp_path / "run") as running:
        wait_until_recorded(peer, publisher)
        sent = publish(publisher, twists(100))
        wait_until_arrived(publisher)
        assert running.stop() == 0
    assert recorded(tmp_path / "run", "/all") == sent


def test_a_deleted_folder_is_noticed_within_two_seconds(tmp_path, peer):
    with recorder(tmp_path / "run") as running:
        (tmp_path / "run").rename(tmp_path / "gone")
        peer.spin_until(lambda: "has gone while it was written" in running.output, 2.0, "the line of the recorder")
        assert running.wait() == 1
        assert "Traceback" not in running.output


def test_a_disk_with_too_little_space_ends_the_recording_with_a_whole_bag(tmp_path, peer):
    with graph.node(RECORDER, {"uri": tmp_path / "run", "min_free_space": 2**50}) as running:
        peer.spin_until(lambda: running.popen.poll() is not None, 30.0, "the end of the recorder")
        assert running.popen.returncode == 1
        assert "must be >= 1125899906842624" in running.output
    with BagReader(tmp_path / "run") as reader:
        assert reader.metadata is not None


def wait_for_count(peer, reports, key, value):
    peer.spin_until(lambda: graph.values(reports[-1])[key] == value, 20.0, f"{key} = {value}")


def test_messages_of_a_second_type_are_reported_at_once_and_counted_as_lost(tmp_path, peer):
    first = peer.publisher(Twist, "shared", 10)
    with recorder(tmp_path / "run", {"topics": ["/shared"], "topic_polling_interval": 0.05}) as running:
        reports = wait_until_recorded(peer, first)
        sent = publish(first, twists(3))
        wait_for_count(peer, reports, "messages", "3")
        peer.spin_for(0.05 * 20)
        with graph.peer("intruder") as other:
            second = other.publisher(String, "shared", DEEP)
            publish(second, [String(data="before anybody listens")] * 4)
            wait_for_count(peer, reports, "incomplete", "/shared")
            assert reports[-1].level == DiagnosticStatus.WARN
            other.wait_for_subscribers(second)
            publish(second, [String(data="not recorded")] * 20)
            wait_for_count(peer, reports, "lost", "24")
        assert running.stop() == 0
        assert running.output.count(" is not recorded: its type is std_msgs/msg/String") <= 2, "also before its name"
        assert "3 messages, 24 lost" in running.output
    assert recorded(tmp_path / "run", "/shared") == sent
    assert metadata.read(tmp_path / "run").custom_data == {"lost_messages": "24", "lost /shared": "24"}


def test_a_weaker_publisher_that_joins_is_recorded_without_loss_or_repetition(tmp_path, peer):
    first = peer.publisher(Twist, "shared", DEEP)
    with recorder(tmp_path / "run", {"topics": ["/shared"], "topic_polling_interval": 0.05}) as running:
        reports = wait_until_recorded(peer, first)
        sent, total = publish(first, twists(5)), 5
        with graph.peer("intruder") as other:
            second = other.publisher(Twist, "shared", BEST_EFFORT)
            # Published throughout the change from one subscription to the other.
            while " subscribing anew because of " not in running.output or graph.values(reports[-1])["incomplete"]:
                sent += publish(first, twists(1))
                peer.spin_for(0.001)
                total += 1
            other.wait_for_subscribers(second)
            peer.wait_for_subscribers(first)
            weak = publish(second, twists(7))
            sent += publish(first, twists(100))
            wait_for_count(peer, reports, "messages", str(total + 107))
        assert running.stop() == 0
        assert f"{total + 107} messages, 0 lost" in running.output
        assert "offers best effort only" in running.output
    assert sorted(recorded(tmp_path / "run", "/shared")) == sorted(sent + weak)


def test_a_weaker_publisher_of_a_topic_with_a_fixed_qos_is_counted_as_lost(tmp_path, peer):
    first = peer.publisher(Twist, "shared", 100)
    (tmp_path / "qos.yaml").write_text("/shared: {reliability: reliable, depth: 50}\n")
    parameters = {"topics": ["/shared"], "qos_profile_overrides_path": tmp_path / "qos.yaml"}
    with recorder(tmp_path / "run", parameters) as running:
        reports = wait_until_recorded(peer, first)
        publish(first, twists(5))
        with graph.peer("intruder") as other:
            second = other.publisher(Twist, "shared", BEST_EFFORT)
            wait_for_count(peer, reports, "incomplete", "/shared")
            # What was sent to nobody is not known.
            peer.spin_until(
                lambda: publish(second, twists(1)) and graph.values(reports[-1])["lost"] != "0", 20.0, "a loss"
            )
            peer.wait_for_subscribers(first, count=2)
            sent = publish(first, twists(10))
            wait_for_count(peer, reports, "messages", "15")
            peer.spin_for(1.0)
            before = int(graph.values(reports[-1])["lost"])
            # Best effort: some may not arrive at all, and those are not known, either.
            peer.spin_until(
                lambda: publish(second, twists(1)) and int(graph.values(reports[-1])["lost"]) >= before + 7,
                20.0,
                "losses",
            )
        assert running.stop() == 0
        assert "is not recorded: it offers best effort only" in running.output
        (lost,) = re.findall(r"15 messages, (\d+) lost", running.output)
        assert before + 7 <= int(lost)
    assert recorded(tmp_path / "run", "/shared")[5:] == sent
