"""Sending with a bound: no message is overwritten before it is acknowledged, and no wait is without an end."""

import threading

import graph
import pytest
from bag_makers import BEGIN, point

from diffbot_bag.metadata import Topic
from diffbot_bag.qos import REPLAY_DEPTH, Qos
from diffbot_bag.reader import RawMessage
from diffbot_bag.ros import patient_outputs
from diffbot_bag.ros.patient_outputs import RCLError
from diffbot_bag.ros.replay_outputs import Naming, ReplayOutputs

ROOM = 5000
"""messages that Fast DDS keeps of a history without a depth"""
BLOCKING_TIME = 0.1
"""[s] for which a publisher without room blocks before it raises"""


class FakeTime:
    """Time that passes only where a publisher blocks."""

    now = 0.0

    @classmethod
    def monotonic(cls):
        return cls.now


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    monkeypatch.setattr(patient_outputs, "time", FakeTime)
    monkeypatch.setattr(FakeTime, "now", 0.0)


class FakePublisher:
    """Keeps as many messages as its QoS says; acknowledges them after some polls or refusals, or never."""

    def __init__(self, profile, polls):
        self.profile, self.polls, self._left = profile, polls, polls
        self.sent, self.kept, self.lost, self.destroyed = [], 0, 0, False

    def publish(self, data):
        assert not self.destroyed
        if self.profile.history.name == "KEEP_ALL":
            if self.kept == ROOM:
                FakeTime.now += BLOCKING_TIME
                self.wait_for_all_acked(None)
                raise RCLError("no room")
        elif self.kept == self.profile.depth:
            self.kept, self.lost = self.kept - 1, self.lost + 1
        self.sent.append(data)
        self.kept += 1

    def wait_for_all_acked(self, _timeout):
        self._left -= 1
        if self._left > 0:
            return False
        self._left, self.kept = self.polls, 0
        return True


class FakeNode:
    def __init__(self, polls=3):
        self.publishers, self.warnings, self._polls = {}, [], polls
        self.destroyed = []

    def create_publisher(self, _kind, name, profile):
        self.publishers[name] = FakePublisher(profile, self._polls)
        return self.publishers[name]

    def destroy_publisher(self, publisher):
        publisher.destroyed = True
        self.destroyed.append(publisher)

    def get_logger(self):
        return self

    def warning(self, text):
        self.warnings.append(text)


def topic(name, qos):
    return Topic(name=name, type="geometry_msgs/msg/Point", type_hash="", qos=(qos,), message_count=1)


TOPICS = {
    "/a": topic("/a", Qos()),
    "/b": topic("/b", Qos(reliability="best_effort")),
    "/map": topic("/map", Qos(durability="transient_local", depth=1)),
}


def send(outputs, name, count):
    for index in range(count):
        outputs.send(RawMessage(name, point(index), BEGIN, BEGIN))


@pytest.mark.parametrize("bound", [1, 30])
def test_with_a_bound_nothing_is_overwritten_before_it_is_acknowledged(bound):
    node = FakeNode()
    outputs = ReplayOutputs(node, TOPICS, Naming({}, {}, bound), threading.Event())
    for name in TOPICS:
        send(outputs, name, 2500)
        publisher = node.publishers[name]
        assert publisher.sent == [point(index) for index in range(2500)]
        assert publisher.lost == 0
        assert publisher.profile.depth == (1 if name == "/map" else max(1, bound // 3))
        assert publisher.profile.reliability.name == "RELIABLE"
    assert outputs.latched == {"/map"}


def test_in_time_a_reliable_topic_waits_for_room():
    node = FakeNode()
    outputs = ReplayOutputs(node, TOPICS, Naming({}, {}, 0, 5.0), threading.Event())
    send(outputs, "/a", 2 * ROOM + 5)
    assert (node.publishers["/a"].sent, node.publishers["/a"].lost) == ([point(i) for i in range(2 * ROOM + 5)], 0)
    # Best effort: nobody acknowledges. Latched: the last ones are kept for those who come later.
    send(outputs, "/b", 2 * REPLAY_DEPTH)
    assert node.publishers["/b"].lost == REPLAY_DEPTH
    send(outputs, "/map", 3)
    assert node.publishers["/map"].lost == 2
    assert not node.warnings


def test_a_subscriber_that_never_acknowledges_delays_once():
    node = FakeNode(polls=10**9)
    outputs = ReplayOutputs(node, {"/a": TOPICS["/a"]}, Naming({"/a": "/b"}, {}, 0, 0.1), threading.Event())
    send(outputs, "/a", ROOM + 100)
    (first,), second = node.destroyed, node.publishers["/b"]
    assert first.sent + second.sent == [point(index) for index in range(ROOM + 100)]
    assert second.profile.history.name == "KEEP_LAST"
    (warning,) = node.warnings
    assert warning == "/a: not acknowledged after 0.1 s, messages may be lost from now on"


@pytest.mark.parametrize(("bound", "room"), [(5, 5), (0, ROOM)])
def test_the_stop_ends_a_wait_without_end(bound, room):
    stop = threading.Event()
    outputs = ReplayOutputs(FakeNode(polls=10**9), {"/a": TOPICS["/a"]}, Naming({}, {}, bound), stop)
    send(outputs, "/a", room)
    thread = threading.Thread(target=send, args=(outputs, "/a", 3))
    thread.start()
    stop.set()
    thread.join(graph.PATIENCE)
    assert not thread.is_alive()


def test_without_patience_the_recorded_depth_decides_and_other_errors_are_raised():
    node = FakeNode(polls=10**9)
    outputs = ReplayOutputs(node, TOPICS, Naming({}, {"/a": Qos("keep_last", 10)}, 0, -1.0), threading.Event())
    send(outputs, "/a", 100)
    assert (len(node.publishers["/a"].sent), node.publishers["/a"].lost, node.warnings) == (100, 90, [])

    def broken(_data):
        raise RCLError("the context is gone")

    outputs = ReplayOutputs(node, TOPICS, Naming({}, {}, 0, 5.0), threading.Event())
    node.publishers["/a"].publish = broken
    with pytest.raises(RCLError, match="gone"):
        send(outputs, "/a", 1)
