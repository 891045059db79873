"""What a recorder takes, keeps and counts as lost: topics, gaps, latched messages."""

import random

import pytest

from diffbot_bag.bag.topic_selection import TopicSelection
from diffbot_bag.record.latched import LatchedMessages
from diffbot_bag.record.lost_messages import GapCounter
from diffbot_bag.record.pending_messages import Held
from diffbot_core.errors import InvalidValueError


def held(number):
    return Held(1, bytes(10), number, 0, number)


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


def lost(numbers, publishers=1):
    gaps = GapCounter()
    gaps.publishers = publishers
    for number in numbers:
        gaps.note(number)
    return gaps.lost


@pytest.mark.parametrize(
    ("numbers", "publishers", "expected"),
    [
        ([1, 2, 5], 1, 2),
        ([1, 3, 5, 6, 10], 1, 5),
        ([1, 2, 3, 1, 2, 3], 1, 0),
        ([5, 6, 1, 2, 4], 1, 1),
        ([1, 101, 2, 102, 3, 105, 4, 106, 9], 2, 2 + 4),
    ],
)
def test_gaps_of_publishers(numbers, publishers, expected):
    assert lost(numbers, publishers) == expected
    many = GapCounter()
    many.publishers = publishers
    for part in (numbers[:3], numbers[3:5], numbers[5:]):
        many.note_all(part)
    assert many.lost == expected


def test_publishers_that_take_turns_lose_nothing():
    random.seed(7)
    for publishers in (2, 3, 8):
        following = [random.randrange(1000) for _ in range(publishers)]
        numbers = []
        for _ in range(2000):
            index = random.randrange(publishers)
            numbers.append(following[index])
            following[index] += 1
        assert lost(numbers, publishers) == 0


@pytest.mark.parametrize(
    ("selection", "taken"),
    [
        (TopicSelection(), {"/odom", "/robot/odom", "/rosout"}),
        (TopicSelection(include_hidden_topics=True), {"/odom", "/robot/odom", "/rosout", "/_hidden", "/a/_b/c"}),
        (TopicSelection(topics=("/odom", "/_hidden")), {"/odom", "/_hidden"}),
        (TopicSelection(regex=".*/odom"), {"/odom", "/robot/odom"}),
        (TopicSelection(topics=("/rosout",), regex="/odom"), {"/rosout", "/odom"}),
        (TopicSelection(exclude_topics=("/odom",)), {"/robot/odom", "/rosout"}),
        (TopicSelection(topics=("/odom",), exclude_topics=("/odom",)), set()),
    ],
)
def test_which_topics_are_taken(selection, taken):
    selection.check()
    topics = {"/odom", "/robot/odom", "/rosout", "/_hidden", "/a/_b/c"}
    assert {topic for topic in topics if selection.selects(topic)} == taken


@pytest.mark.parametrize("name", ["regex", "exclude_regex"])
def test_a_wrong_expression_is_named(name):
    with pytest.raises(InvalidValueError, match=rf"{name} = '\(': must be a regular expression"):
        TopicSelection(**{name: "("}).check()
