"""The recorder: what was published over DDS is in the bag, to the byte and in order, and what is missing is counted."""

import re
import signal
import statistics
import time

import bag_makers
import geometry_msgs.msg
import graph
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.qos import QoSProfile
from recorders import BEST_EFFORT, DEEP, DEEP_LATCHED, KEEP_ALL, LATCHED, Recorder, publish, recorded, twists
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from diffbot_bag.bag import metadata
from diffbot_bag.bag.reader import BagReader
from diffbot_bag.recorder_node import RecorderNode
from diffbot_bag.ros import recorded_topic
from diffbot_core.errors import DiffbotError

pytestmark = pytest.mark.graph

RELIABLE = QoSProfile(depth=1000)


@pytest.fixture
def peer(nodes):
    return nodes.peer


def custom_data(folder):
    return metadata.read(folder).custom_data


def test_publishers_of_every_qos_are_recorded_to_the_byte(nodes, peer, tmp_path):
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
    # The recorder has not been given the time to take them: it does so at its end.
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
    # rosbag2's default: what belongs to the graph itself is recorded, too. The recorder's own status is not.
    assert {"/rosout", "/parameter_events"} <= set(topics)
    assert not {"/recorder/status", "/without_a_publisher"} & set(topics)


def test_selected_topics_are_recorded_with_names_of_its_namespace(nodes, peer, tmp_path):
    a, b, other, hidden = (peer.publisher(Twist, name) for name in ("/robot/a", "/robot/b", "/other", "/_hidden"))
    selection = {"topics": ["a", "/_hidden", "/never"], "regex": "/o.*", "exclude_topics": ["b"]}
    recorder = Recorder(nodes, tmp_path / "run", ("-r", "__ns:=/robot", "-r", "__node:=box"), **selection)
    for each in (a, other, hidden):
        peer.spin_until(each.get_subscription_count, what=each.topic_name)
    assert b.get_subscription_count() == 0
    recorder.close()
    assert {topic.name for topic in metadata.read(tmp_path / "run").topics} == {"/robot/a", "/other", "/_hidden"}


def test_lost_messages_are_counted_reported_and_kept(nodes, peer, tmp_path):
    publisher = peer.publisher(Twist, "noise", RELIABLE)
    recorder = Recorder(nodes, tmp_path / "run", depth=5, topics=["/noise"])
    health = peer.subscribe(DiagnosticArray, "/diagnostics", 100)
    recorder.wait_for(publisher)
    sent = publish(publisher, twists(1))
    recorder.wait("messages", 1)
    # Meanwhile it takes nothing, and its queue keeps the newest five.
    sent += publish(publisher, twists(50, first=1))
    recorder.wait("lost", 45)
    assert recorder.reports[-1].level == DiagnosticStatus.WARN
    peer.spin_until(
        lambda: any(
            graph.values(one).get("/noise dropped: lost") == "45" for report in health for one in report.status
        ),
        what="lost messages in /diagnostics",
    )
    recorder.close()
    assert custom_data(tmp_path / "run") == {"lost_messages": "45", "lost /noise": "45"}
    assert recorded(tmp_path / "run", "/noise") == sent[:1] + sent[-5:]


def tick(recorder, clock, seconds):
    """Send a simulated time until the recorder has it."""
    message = Clock()
    message.clock.sec = seconds

    def arrived():
        clock.publish(message)
        return recorder.node.get_clock().now().nanoseconds == seconds * 10**9

    recorder.peer.spin_until(arrived, what=f"{seconds} s")


def test_log_times_are_simulated_and_what_comes_before_the_first_has_it(nodes, peer, tmp_path):
    clock, data = peer.publisher(Clock, "/clock"), peer.publisher(Twist, "data", RELIABLE)
    recorder = Recorder(nodes, tmp_path / "run", use_sim_time=True, topics=["/data"])
    recorder.wait_for(data)
    assert recorder.reports[-1].message == "waiting for /clock"
    sent = publish(data, twists(3))
    recorder.wait("held", 3)
    tick(recorder, clock, 500)
    sent += publish(data, twists(1, first=3))
    peer.spin_until(lambda: recorder.value("messages") == "4", what="the first messages")
    tick(recorder, clock, 900)
    sent += publish(data, twists(5, first=4))
    recorder.close()
    with BagReader(tmp_path / "run") as reader:
        messages = list(reader.messages())
    assert [one.data for one in messages] == sent
    assert [one.log_time // 10**9 for one in messages] == [500] * 4 + [900] * 5


def test_without_a_clock_messages_keep_the_time_of_reception(nodes, peer, tmp_path, capfd):
    data = peer.publisher(Twist, "data", RELIABLE)
    recorder = Recorder(nodes, tmp_path / "run", use_sim_time=True, max_held=5, topics=["/data"])
    recorder.wait_for(data)
    begin = peer.node.get_clock().now().nanoseconds
    sent = publish(data, twists(8))
    recorder.close()
    assert "no /clock received: 5 messages keep their time of reception" in capfd.readouterr().err
    assert recorded(tmp_path / "run", "/data") == sent[:5]
    with BagReader(tmp_path / "run") as reader:
        assert reader.start >= begin


def test_topics_without_a_type_or_with_two_are_named_once_and_the_rest_is_recorded(
    nodes, peer, tmp_path, capfd, monkeypatch
):
    good, odd, foreign = (
        peer.publisher(kind, name) for kind, name in ((Twist, "good"), (Twist, "odd"), (TwistStamped, "foreign"))
    )
    original = RecorderNode.get_topic_names_and_types
    two = {"/odd": ["std_msgs/msg/String"]}
    monkeypatch.setattr(
        RecorderNode,
        "get_topic_names_and_types",
        lambda node: [(name, types + two.get(name, [])) for name, types in original(node)],
    )
    monkeypatch.delattr(geometry_msgs.msg, "TwistStamped")
    recorder = Recorder(nodes, tmp_path / "run")
    recorder.wait_for(good)
    names = {name for name, _ in original(recorder.node)}
    assert {"/odd", "/foreign"} <= names
    for _ in range(5):
        recorder.node.update_subscriptions()
    sent = publish(good, twists(3))
    recorder.close()
    output = capfd.readouterr().err
    (line,) = [line for line in output.splitlines() if "/foreign is not recorded" in line]
    assert "type geometry_msgs/msg/TwistStamped" in line
    (line,) = [line for line in output.splitlines() if "/odd is not recorded" in line]
    assert "several types (geometry_msgs/msg/Twist, std_msgs/msg/String)" in line
    assert odd.get_subscription_count() == foreign.get_subscription_count() == 0
    assert recorded(tmp_path / "run", "/good") == sent


def test_a_publisher_of_a_second_type_is_reported_and_the_first_ones_messages_are_recorded(
    nodes, peer, tmp_path, capfd
):
    first = peer.publisher(Twist, "shared", RELIABLE)
    recorder = Recorder(nodes, tmp_path / "run", topics=["/shared"])
    recorder.wait_for(first)
    sent = publish(first, twists(3))
    with graph.peer("intruder") as other:
        second = other.publisher(String, "shared", DEEP)
        publish(second, [String(data="not recorded")] * 4)
        recorder.wait("incomplete", "/shared")
        assert recorder.reports[-1].level == DiagnosticStatus.WARN
    recorder.close()
    # Once more at most, if its node was discovered later than its publisher.
    assert capfd.readouterr().err.count(" is not recorded: its type is std_msgs/msg/String") in (1, 2)
    assert recorded(tmp_path / "run", "/shared") == sent
    assert custom_data(tmp_path / "run") == {"lost_messages": "0"}


def test_a_weaker_publisher_that_joins_is_recorded_without_loss_or_repetition(nodes, peer, tmp_path, monkeypatch):
    first = peer.publisher(Twist, "shared", DEEP)
    recorder = Recorder(nodes, tmp_path / "run", topics=["/shared"])
    recorder.wait_for(first)
    sent = publish(first, twists(5))
    with graph.peer("intruder") as other, monkeypatch.context() as patch:
        for bound in ("_OVERLAP_POLLS", "_MAX_OVERLAP_POLLS"):
            patch.setattr(recorded_topic, bound, 10**9)
        second = other.publisher(Twist, "shared", BEST_EFFORT)

        def both():
            # Published throughout the change from one subscription to the other.
            sent.extend(publish(first, twists(1, len(sent))))
            peer.spin_for(0.005)
            subscriptions = [one for one in recorder.node.subscriptions if one.topic_name == "/shared"]
            counts = sorted(one.get_publisher_count() for one in subscriptions)
            return counts == [1, 2] and second.get_subscription_count() == 1

        peer.spin_until(both, what="both subscriptions")
        sent += publish(second, twists(7, -7)) + publish(first, twists(100, len(sent)))
        patch.undo()
        peer.spin_until(lambda: first.get_subscription_count() == 1, what="the end of the first subscription")
        recorder.wait("incomplete", "")
        sent += publish(second, twists(7, -14)) + publish(first, twists(100, len(sent)))
        recorder.wait("messages", len(sent))
    recorder.close()
    assert sorted(recorded(tmp_path / "run", "/shared")) == sorted(sent)
    assert custom_data(tmp_path / "run") == {"lost_messages": "0"}


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"regex": "("}, r"regex = '(': must be a regular expression"),
        ({"max_bag_size": 5}, "max_bag_size = 5: must be 0 or >= chunk_size"),
        ({"qos_profile_overrides_path": "/none.yaml"}, "cannot open /none.yaml: No such file"),
        ({"uri": "/proc/none/run"}, "cannot create the bag"),
    ],
)
def test_what_it_refuses_to_start_with_leaves_no_folder(nodes, tmp_path, parameters, words):
    with pytest.raises(DiffbotError, match=re.escape(words)):
        Recorder(nodes, tmp_path / "run", **parameters)
    assert not (tmp_path / "run").exists()


def test_a_kill_at_any_time_costs_half_a_second_at_most_with_default_parameters(peer, tmp_path):
    folder, sender = tmp_path / "run", peer.publisher(TwistStamped, "data", 1000)
    with graph.node("diffbot_bag.recorder_node", {"uri": folder, "topics": ["/data"]}) as recorder:
        graph.wait_for(sender.get_subscription_count, what="the recorder")
        ages, newest = [], 0
        while len(ages) < 6:
            sender.publish(TwistStamped())
            before, newest = newest, newest_time(folder)
            if newest > before > 0:
                # A kill just before this flush would have cost what came after the flush before it.
                ages.append((time.time_ns() - before) * 1e-9)
            time.sleep(0.005)
        recorder.send(signal.SIGKILL)
        recorder.wait()
    assert newest_time(folder) >= newest
    # The median: on a busy machine a flush may be held up.
    assert statistics.median(ages) <= 0.5


def newest_time(folder):
    """Log time [ns] of the newest message in a bag that may be unfinished; 0 without one."""
    return max((one.log_time for one in bag_makers.unfinished(folder / f"{folder.name}_0.mcap")), default=0)
