"""Held, kept and left out messages; the ring of a snapshot, and facts of the host."""

import os

import pytest

from diffbot_bag.mcap.attachments import dump
from diffbot_bag.record.host import host_facts
from diffbot_bag.record.latched import LatchedMessages
from diffbot_bag.record.pending_messages import Held
from diffbot_bag.record.snapshot import OVERHEAD, SnapshotBuffer


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
