"""Held, kept and left out messages; the ring of a snapshot, and facts of the host."""

import os

import pytest
from mcap.reader import make_reader

from diffbot_bag.bag.qos import Qos
from diffbot_bag.bag.writer import BagWriter
from diffbot_bag.mcap.attachments import dump
from diffbot_bag.record.host import host_facts
from diffbot_bag.record.latched import LatchedMessages
from diffbot_bag.record.pending_messages import Held
from diffbot_bag.record.recording import Recording
from diffbot_bag.record.snapshot import OVERHEAD, SnapshotBuffer

STRING = "std_msgs/msg/String"
BEGIN = 10**18


class Bag:
    def __init__(self, folder, **options):
        self.writer = BagWriter(folder)
        self.data = self.writer.add_topic("/data", STRING, [Qos()])
        self.map = self.writer.add_topic("/map", STRING, [Qos(durability="transient_local")])
        self.recording = Recording(self.writer, **options)

    def accept(self, channel, number, at=None):
        time = BEGIN + number if at is None else at
        return self.recording.accept(channel, b"%d" % number, time, time - 1, number)

    def contents(self):
        """Data and log time of each message, by file."""
        self.recording.finish()
        self.writer.close()
        files = []
        for path in sorted(self.writer.folder.glob("*.mcap")):
            with path.open("rb") as stream:
                messages = make_reader(stream).iter_messages(log_time_order=False)
                files.append([(channel.topic, int(one.data), one.log_time - BEGIN) for _, channel, one in messages])
        return files


def test_a_snapshot_has_the_newest_messages_and_the_latched_ones_before(tmp_path):
    bag = Bag(tmp_path / "run", snapshot=SnapshotBuffer(3 * (OVERHEAD + 2)))
    assert bag.recording.take_snapshot() == (False, "no message in memory")
    bag.accept(bag.map, 1)
    for number in range(10, 20):
        bag.accept(bag.data, number)
    assert bag.writer.count == 0
    assert bag.recording.take_snapshot() == (True, "3 messages")
    assert bag.recording.take_snapshot()[0] is False, "the first one is not written yet"
    bag.accept(bag.data, 20)
    bag.recording.write_snapshot()
    bag.accept(bag.data, 21)
    bag.recording.take_snapshot()
    first, second = bag.contents()
    assert first == [("/map", 1, 17), ("/data", 17, 17), ("/data", 18, 18), ("/data", 19, 19)]
    assert second == [("/map", 1, 20), ("/data", 20, 20), ("/data", 21, 21)]


def held(number, size=10, at=None):
    return Held(1, bytes(size), number if at is None else at, 0, number)


def test_a_ring_keeps_the_newest_within_its_bytes():
    ring = SnapshotBuffer(4 * (OVERHEAD + 10))
    left = [one.number for number in range(10) for one in ring.push(held(number))]
    assert left == list(range(6))
    assert ring.size == 4 * (OVERHEAD + 10)
    assert [one.number for one in ring.push(held(10, 2 * OVERHEAD))] == [6, 7, 8]
    assert [one.number for one in ring.push(held(11, 10**6))] == [9, 10, 11], "it does not fit at all"
    assert (len(ring), ring.size) == (0, 0)


def test_a_ring_keeps_the_newest_within_its_duration():
    ring = SnapshotBuffer(10**9, max_duration=30)
    for number in range(10):
        ring.push(held(number, at=number * 10))
    assert [one.number for one in ring.take()] == [6, 7, 8, 9]
    assert (len(ring), ring.size) == (0, 0)


@pytest.mark.parametrize(
    ("publishers", "numbers", "expected"),
    [
        (1, [1, 2, 3], [3]),
        (1, [5, 1], [1]),
        (2, [1, 8, 2, 9, 10], [2, 10]),
        (2, [1, 1, 2, 2], [1, 1, 2, 2]),
        (3, [0, 0, 0, 0, 0, 0, 0], [0] * 6),
    ],
)
def test_what_is_latched(publishers, numbers, expected):
    latched = LatchedMessages(publishers)
    for number in numbers:
        latched.keep(held(number))
    kept = [message.number for message in latched]
    assert kept == expected


def test_host_facts_contain_versions_and_no_secrets(monkeypatch):
    monkeypatch.setenv("MY_TOKEN", "do not record this")
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    facts = host_facts()
    assert b"do not record this" not in dump(facts)
    assert facts["ros"]["ROS_DISTRO"] == "jazzy"
    assert facts["host"]["cores"] == os.cpu_count()
    assert facts["dependencies"]["mcap"]
    assert facts["package"]["diffbot"]
