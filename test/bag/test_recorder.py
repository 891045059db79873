"""The recorder: published messages are in the bag, byte by byte and in order, and lost messages are counted."""

import itertools
import json
import time
from types import SimpleNamespace
from unittest import mock

import bag_makers
import graph
import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.qos import QoSProfile
from recorders import BEST_EFFORT, DEEP, DEEP_LATCHED, KEEP_ALL, LATCHED, Recorder, publish, recorded, twists
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger

from diffbot_bag import metadata, node_parameters, recorder_node
from diffbot_bag.bag import BagReader
from diffbot_bag.qos import Qos
from diffbot_bag.recorded_topic import RecordedTopic
from diffbot_bag.recorder_node import RecorderNode
from diffbot_bag.writer import BagWriteError

pytestmark = pytest.mark.graph

RELIABLE = QoSProfile(depth=1000)


def custom_data(folder):
    return metadata.read(folder).custom_data


def test_messages_of_publishers_with_any_qos_are_recorded_byte_by_byte(nodes, tmp_path):
    peer = nodes.peer
    latched = peer.publisher(String, "/description", LATCHED)
    sent = {"/description": publish(latched, [String(data="<robot/>")])}
    recorder = Recorder(nodes, tmp_path / "run")
    offers = {"/noise": [BEST_EFFORT], "/all": [KEEP_ALL], "/mixed": [RELIABLE, BEST_EFFORT, DEEP_LATCHED]}
    publishers = {topic: [peer.publisher(Twist, topic, qos) for qos in ones] for topic, ones in offers.items()}
    hidden = peer.publisher(Twist, "/a/_b/c")
    peer.subscribe(Twist, "/without_a_publisher")
    recorder.wait_for(latched, *(one for ones in publishers.values() for one in ones))
    # A latched message follows some time after its reader is known.
    peer.spin_until(lambda: recorder.node.health.accepted["/description"] == 1, what="the latched message")
    begin = peer.node.get_clock().now().nanoseconds
    for topic, ones in publishers.items():
        sent[topic] = [data for number, one in enumerate(ones) for data in publish(one, twists(100, 100 * number))]
    end = peer.node.get_clock().now().nanoseconds
    (info,) = peer.node.get_publishers_info_by_topic("/noise")
    assert hidden.get_subscription_count() == 0
    # The recorder was not spun since: it takes the messages from its queues when it ends.
    recorder.close()
    for topic, messages in sent.items():
        assert sorted(recorded(tmp_path / "run", topic)) == sorted(messages), topic
    assert recorded(tmp_path / "run", "/all") == sent["/all"]
    assert custom_data(tmp_path / "run") == {"lost_messages": "0"}
    with BagReader(tmp_path / "run") as reader:
        topics = reader.topics
        times = [(one.publish_time, one.log_time) for one in reader.messages(["/noise"])]
    assert topics["/noise"].type_hash == str(info.topic_type_hash)
    assert [qos.reliability for qos in topics["/noise"].qos] == ["best_effort"]
    assert [qos.durability for qos in topics["/description"].qos] == ["transient_local"]
    assert len(topics["/mixed"].qos) == 3
    assert times == sorted(times)
    assert all(begin <= published <= received and published <= end for published, received in times)
    # As in rosbag2, topics of the graph itself are recorded, too. The recorder's own status is not.
    assert {"/rosout", "/parameter_events"} <= set(topics)
    assert not {"/recorder/status", "/without_a_publisher"} & set(topics)


def test_a_topic_with_a_subscriber_of_another_type_is_recorded_but_not_one_with_two_published_types(nodes, tmp_path):
    types, publishers = dict[str, list[str]](), [nodes.peer.publisher(Twist, name, RELIABLE) for name in ("one", "two")]
    with graph.peer(name="other") as other:
        other.subscribe(TwistStamped, "one")
        other.publisher(TwistStamped, "two")
        nodes.peer.spin_until(
            lambda: (
                types.update(nodes.peer.node.get_topic_names_and_types())
                or len(types.get("/one", ())) == len(types.get("/two", ())) == 2
            ),
            what="all types",
        )
        recorder = Recorder(nodes, tmp_path / "run", topics=["/one", "/two"])
        recorder.wait_for(publishers[0])
        sent = publish(publishers[0], twists(5))
        recorder.wait("incomplete", "/two")
        recorder.close()
    assert recorded(tmp_path / "run", "/one") == sent


def test_lost_messages_are_counted_in_status_diagnostics_and_the_bag(nodes, tmp_path):
    publisher = nodes.peer.publisher(Twist, "noise", RELIABLE)
    (tmp_path / "qos.yaml").write_text("/noise: {depth: 5}\n")
    overrides = str(tmp_path / "qos.yaml")
    recorder = Recorder(nodes, tmp_path / "run", qos_profile_overrides_path=overrides, topics=["/noise"])
    health = nodes.peer.subscribe(DiagnosticArray, "/diagnostics", 100)
    recorder.wait_for(publisher)
    sent = publish(publisher, twists(1))
    recorder.wait("messages", 1)
    # The recorder is not spun meanwhile, so that its queue keeps the newest five.
    sent += publish(publisher, twists(50, first=1))
    recorder.wait("lost", 45)
    assert recorder.reports[-1].level == DiagnosticStatus.WARN
    nodes.peer.spin_until(
        lambda: any(
            graph.values(one).get("/noise dropped: lost") == "45" for report in health for one in report.status
        ),
        what="lost messages in /diagnostics",
    )
    recorder.close()
    assert custom_data(tmp_path / "run") == {"lost_messages": "45", "lost /noise": "45"}
    assert recorded(tmp_path / "run", "/noise") == sent[:1] + sent[-5:]


def tick(recorder, clock, seconds):
    """Publish a simulated time until the recorder has received it."""
    message = Clock()
    message.clock.sec = seconds

    def arrived():
        clock.publish(message)
        return recorder.node.get_clock().now().nanoseconds == seconds * 10**9

    recorder.peer.spin_until(arrived, what=f"{seconds} s")


def test_messages_before_the_first_clock_are_held_and_get_its_time(nodes, tmp_path):
    clock, data = nodes.peer.publisher(Clock, "/clock"), nodes.peer.publisher(Twist, "data", RELIABLE)
    recorder = Recorder(nodes, tmp_path / "run", use_sim_time=True, topics=["/data"])
    recorder.wait_for(data)
    assert recorder.reports[-1].message == "waiting for /clock"
    sent = publish(data, twists(3))
    recorder.wait("held", 3)
    tick(recorder, clock, 500)
    sent += publish(data, twists(1, first=3))
    recorder.wait("messages", 4)
    tick(recorder, clock, 900)
    sent += publish(data, twists(5, first=4))
    recorder.close()
    with BagReader(tmp_path / "run") as reader:
        messages = list(reader.messages())
    assert [one.data for one in messages] == sent
    assert [one.log_time // 10**9 for one in messages] == [500] * 4 + [900] * 5


def test_messages_beyond_the_cache_before_the_first_clock_are_lost_and_not_received(nodes, tmp_path):
    data, cache = nodes.peer.publisher(String, "data", RELIABLE), 2**20
    recorder = Recorder(nodes, tmp_path / "run", use_sim_time=True, topics=["/data"], max_cache_size=cache)
    recorder.wait_for(data)
    for _ in range(3):
        data.publish(String(data="x" * (cache // 2)))
    recorder.wait("lost", 2)
    assert recorder.node._topics["/data"].received == 1
    recorder.close()
    assert custom_data(tmp_path / "run") == {"lost_messages": "2", "lost /data": "2"}


def test_a_weaker_publisher_that_joins_is_recorded_and_messages_lost_in_the_change_are_counted(nodes, tmp_path):
    first = nodes.peer.publisher(Twist, "shared", DEEP)
    recorder = Recorder(nodes, tmp_path / "run", topics=["/shared"])
    recorder.wait_for(first)
    sent = publish(first, twists(5))
    with graph.peer("intruder") as other:
        second = other.publisher(Twist, "shared", BEST_EFFORT)

        def both():
            # Published throughout the change from one subscription to the other.
            sent.extend(publish(first, twists(1, len(sent))))
            (subscription,) = [one for one in recorder.node.subscriptions if one.topic_name == "/shared"]
            return subscription.get_publisher_count() == 2 and second.get_subscription_count() == 1

        nodes.peer.spin_until(both, what="both publishers")
        after = publish(second, twists(7, -7)) + publish(first, twists(100, len(sent)))
        recorder.wait("incomplete", "")
        total, node = len(sent) + len(after), recorder.node
        nodes.peer.spin_until(lambda: node._writer.count + node._lost() == total, what="all messages")
    recorder.close()
    found = recorded(tmp_path / "run", "/shared")
    assert sorted(found[-len(after) :]) == sorted(after)
    missing = set(sent) - set(found)
    assert len(found) + len(missing) == len(sent) + len(after)
    assert custom_data(tmp_path / "run")["lost_messages"] == str(len(missing))


class Recording:
    """A recorder that is subscribed to /data and the latched /map, and its publishers."""

    def __init__(self, nodes, folder, **parameters):
        """Start, and wait until the latched message is recorded, so that it does not arrive during the test."""
        self.peer = nodes.peer
        self.data, latched = self.peer.publisher(Twist, "data", DEEP), self.peer.publisher(String, "map", LATCHED)
        latched.publish(String(data="map"))
        self.recorder = Recorder(nodes, folder, topics=["/data", "/map"], **parameters)
        self.recorder.wait_for(self.data, latched)
        self.peer.spin_until(lambda: self.recorder.node.health.accepted["/map"] == 1, what="the latched message")

    def call(self, service):
        answer = self.peer.call(Trigger, f"/recorder/{service}")
        return answer.success, answer.message


def numbers(folder, topic):
    """Return the sequence numbers of a topic by file, as the mcap library reads them."""
    files = [bag_makers.facts(folder / file.name) for file in metadata.read(folder).files]
    return [[one.sequence for one in found if one.topic == topic] for found in files]


def test_files_split_by_size_and_service_continue_each_other_and_the_oldest_are_deleted(nodes, tmp_path):
    recording = Recording(nodes, tmp_path / "run", max_bag_size=2**16, max_bag_files=3, compression="none")
    publish(recording.data, twists(100))
    recording.recorder.wait("messages", 101)
    assert recording.call("split_bagfile") == (True, "run_0.mcap is complete")
    assert recording.call("split_bagfile") == (False, "run_0.mcap does not have messages")
    assert numbers(tmp_path / "run", "/data") == [list(range(1, 101))]
    publish(recording.data, twists(4000))
    recording.recorder.close()
    by_file = numbers(tmp_path / "run", "/data")
    assert len(by_file) == len(list((tmp_path / "run").glob("*.mcap"))) == 3
    found = [number for file in by_file for number in file]
    assert 101 < found[0] < 4000
    assert found == list(range(found[0], 4101))
    assert numbers(tmp_path / "run", "/map") == [[1]] * 3


def test_a_pause_records_latched_messages_only_and_does_not_count_as_loss(nodes, tmp_path):
    recording = Recording(nodes, tmp_path / "run", start_paused=True)
    assert recording.call("is_paused") == (True, "paused")
    publish(recording.data, twists(10))
    health = recording.recorder.node.health
    counted = "/data not recorded during a pause"
    nodes.peer.spin_until(lambda: health.counted[counted] == 10, what="all messages")
    assert recording.recorder.node._topics["/data"].received == 0
    assert recording.call("resume") == (True, "recording")
    publish(recording.data, twists(10))
    recording.recorder.wait("messages", 11)
    assert recording.call("pause") == (True, "paused")
    nodes.peer.spin_until(lambda: recording.recorder.reports[-1].message == "paused", what="the report")
    recording.recorder.close()
    assert custom_data(tmp_path / "run") == {"lost_messages": "0"}
    assert numbers(tmp_path / "run", "/data") == [list(range(11, 21))]
    assert numbers(tmp_path / "run", "/map") == [[1]]


def test_parameters_of_nodes_are_attached_while_recording_and_secrets_are_hidden(tmp_path, monkeypatch):
    monkeypatch.setattr(node_parameters, "DEADLINE", graph.PATIENCE)
    services = {"start_parameter_services": True}
    # Both nodes offer the services. The second one is not spun, and by its name it is requested first.
    with one_process.nodes(name="asked", **services) as nodes, graph.peer("a_silent_one", **services):
        for name, value in {"gain": 0.25, "names": ["a", "b"], "api_key": "abc"}.items():
            nodes.peer.node.declare_parameter(name, value)
        recording = Recording(nodes, tmp_path / "run")
        path, asking = tmp_path / "run" / "run_0.mcap", recording.recorder.node._node_parameters
        silent = "/a_silent_one"
        nodes.peer.spin_until(lambda: asking._name == silent, what="the request to it")
        asking._deadline = 0.0
        again = lambda: asking._name == silent in asking._slow and asking._request is not None  # noqa: E731
        nodes.peer.spin_until(again, what="the second request to it")
        asking._deadline = 0.0
        # The parameters are attached while recording, so that the bag of a killed recorder contains them.
        nodes.peer.spin_until(lambda: b'"gain": 0.25' in path.read_bytes(), what="the parameters")
        recording.recorder.close()
    with BagReader(tmp_path / "run") as reader:
        found = reader.node_parameters()
    values = {"gain": 0.25, "names": ["a", "b"], "api_key": node_parameters.HIDDEN}
    assert {name: found["/asked"][name] for name in values} == values
    assert found["/recorder"]["uri"] == str(tmp_path / "run")
    assert "/a_silent_one" not in found


def test_a_node_that_does_not_answer_is_asked_once_more_after_the_others(monkeypatch):
    asked, attached = [], []

    class Asking(node_parameters.NodeParameters):
        def _request_parameters(self, name):
            asked.append(name)
            while name == "/dead" or (name == "/late" and asked.count(name) == 1):
                yield
            self._add(name, {"gain": 1.0})

    names = ("dead", "fast", "late", "slow")
    node = SimpleNamespace(
        get_node_names_and_namespaces=lambda: [(name, "/") for name in names],
        get_fully_qualified_name=lambda: "/recorder",
    )
    seconds = itertools.count()
    monkeypatch.setattr(node_parameters, "time", SimpleNamespace(monotonic=lambda: float(next(seconds))))
    asking = Asking(node, attached.append)
    for _ in range(100):
        asking.poll()
    assert asked == ["/dead", "/fast", "/late", "/slow", "/dead", "/late"]
    assert sorted(json.loads(attached[-1])) == ["/fast", "/late", "/slow"]


def test_a_publisher_whose_clock_is_behind_does_not_delay_the_end():
    begin, queue = time.monotonic(), itertools.cycle([1, None])

    def take_queued():
        assert time.monotonic() < begin + 5.0, "the recorder does not end"
        return next(queue)

    node = SimpleNamespace(
        _topics={"/data": SimpleNamespace(take_queued=take_queued)}, _writer=SimpleNamespace(closed=False)
    )
    RecorderNode._record_queued(node)


@pytest.mark.parametrize(("sent", "received", "time"), [(5, 3, 3), (3, 5, 3), (5, 0, 5)])
def test_a_queued_message_of_a_publisher_whose_clock_is_ahead_has_its_time_of_reception(sent, received, time):
    taken = b"", {"source_timestamp": sent, "received_timestamp": received}
    topic = RecordedTopic(None, "/data", "std_msgs/msg/String", 1, Qos(), fixed=False)
    topic._subscription = mock.MagicMock()
    topic._subscription.handle.take_message.return_value = taken
    assert topic.take_queued() == time


def test_low_disk_space_ends_the_recording_with_a_finished_bag(nodes, tmp_path, monkeypatch):
    monkeypatch.setattr(recorder_node, "MIN_FREE_SPACE", 10**18)
    recorder = Recorder(nodes, tmp_path / "run")
    nodes.peer.spin_until(lambda: recorder.node.exit_code is not None, what="the end")
    assert recorder.node.exit_code == 1
    recorder.close()
    assert custom_data(tmp_path / "run") == {"lost_messages": "0"}


@pytest.mark.parametrize("error", [BagWriteError("the disk is full"), RuntimeError("a fault of the graph")])
def test_an_error_in_the_first_search_for_topics_leaves_a_finished_bag(nodes, tmp_path, monkeypatch, error):
    def fail(_node):
        raise error

    monkeypatch.setattr(RecorderNode, "update_subscriptions", fail)
    recorder = Recorder(nodes, tmp_path / "run")
    assert recorder.node.exit_code == (1 if isinstance(error, BagWriteError) else None)
    recorder.close()
    assert bag_makers.read(tmp_path / "run") == {}
    assert custom_data(tmp_path / "run") == {"lost_messages": "0"}


def test_a_topic_that_cannot_be_recorded_is_reported_and_does_not_affect_other_topics(nodes, tmp_path, monkeypatch):
    subscribe = RecordedTopic.subscribe

    def fail_for_one(topic, *arguments):
        if topic.name == "/bad":
            raise RuntimeError("a fault of the middleware")
        subscribe(topic, *arguments)

    monkeypatch.setattr(RecordedTopic, "subscribe", fail_for_one)
    publishers = [nodes.peer.publisher(Twist, name, RELIABLE) for name in ("bad", "good")]
    recorder = Recorder(nodes, tmp_path / "run", topics=["/bad", "/good"])
    recorder.wait_for(publishers[1])
    recorder.wait("incomplete", "/bad")
    assert recorder.reports[-1].level == DiagnosticStatus.WARN
    sent = publish(publishers[1], twists(5))
    recorder.close()
    assert recorded(tmp_path / "run", "/good") == sent
    assert {topic.name for topic in metadata.read(tmp_path / "run").topics} == {"/bad", "/good"}
