"""Sending with a bound: no message is overwritten before it is acknowledged, and no wait is without an end."""

import threading

import pytest
from bag_makers import BEGIN, point

from diffbot_bag.metadata import Topic
from diffbot_bag.qos import REPLAY_DEPTH, Qos
from diffbot_bag.reader import RawMessage
from diffbot_bag.ros.replay_outputs import Naming, ReplayOutputs


class FakePublisher:
    """Keeps as many messages as its QoS says; acknowledges them after some polls, or never."""

    def __init__(self, profile, polls):
        self.profile, self.polls, self._left = profile, polls, polls
        self.sent, self.kept, self.lost = [], 0, 0

    def publish(self, data):
        self.sent.append(data)
        self.kept += 1
        if self.kept > self.profile.depth:
            self.kept, self.lost = self.profile.depth, self.lost + 1

    def wait_for_all_acked(self, _timeout):
        self._left -= 1
        if self._left > 0:
            return False
        self._left, self.kept = self.polls, 0
        return True


class FakeNode:
    def __init__(self, polls=3):
        self.publishers, self.warnings, self._polls = {}, [], polls

    def create_publisher(self, _kind, name, profile):
        self.publishers[name] = FakePublisher(profile, self._polls)
        return self.publishers[name]

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


@pytest.mark.parametrize("bound", [1, 2, 30, 1000])
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


def test_in_time_a_reliable_topic_waits_for_its_whole_history():
    node = FakeNode()
    outputs = ReplayOutputs(node, TOPICS, Naming({}, {}, 0, 5.0), threading.Event())
    send(outputs, "/a", 2 * REPLAY_DEPTH + 5)
    assert (len(node.publishers["/a"].sent), node.publishers["/a"].lost) == (2 * REPLAY_DEPTH + 5, 0)
    # Best effort: nobody acknowledges.
    send(outputs, "/b", 2 * REPLAY_DEPTH)
    assert node.publishers["/b"].lost == REPLAY_DEPTH
    assert not node.warnings


@pytest.mark.parametrize(("patience", "warnings"), [(0.02, 1), (-1.0, 0)])
def test_a_subscriber_that_never_acknowledges_delays_once(patience, warnings):
    node = FakeNode(polls=10**9)
    naming = Naming({}, {"/a": Qos("keep_last", 10)}, 0, patience)
    outputs = ReplayOutputs(node, {"/a": TOPICS["/a"]}, naming, threading.Event())
    send(outputs, "/a", 100)
    assert len(node.publishers["/a"].sent) == 100
    assert len(node.warnings) == warnings
    assert all(text.startswith("/a: not acknowledged after 0.02 s") for text in node.warnings)


def test_the_stop_ends_a_wait_without_end():
    stop = threading.Event()
    outputs = ReplayOutputs(FakeNode(polls=10**9), {"/a": TOPICS["/a"]}, Naming({}, {}, 5), stop)
    send(outputs, "/a", 5)
    thread = threading.Thread(target=send, args=(outputs, "/a", 3))
    thread.start()
    stop.set()
    thread.join(5.0)
    assert not thread.is_alive()
