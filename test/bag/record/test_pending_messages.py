"""Lost messages, messages before the first /clock, and which topics are taken."""

import random

import pytest

from diffbot_bag.bag.topic_selection import TopicSelection, absolute
from diffbot_bag.record.lost_messages import GapCounter
from diffbot_bag.record.pending_messages import Held, HeldMessages
from diffbot_core.errors import InvalidValueError


def lost(numbers, publishers=1):
    gaps = GapCounter()
    gaps.publishers = publishers
    for number in numbers:
        gaps.note(number)
    return gaps.lost


@pytest.mark.parametrize(
    ("numbers", "publishers", "expected"),
    [
        ([], 1, 0),
        ([700, 701], 1, 0),
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


def held(number):
    return Held(channel=3, data=b"x", received=100 + number, published=90 + number, number=number)


def test_held_messages_come_back_in_order_and_once():
    waiting = HeldMessages(2)
    assert [waiting.hold(held(number)) for number in range(3)] == [True, True, False]
    assert len(waiting) == 2
    assert waiting.release() == [held(0), held(1)]
    assert held(1).at(7_000) == (3, b"x", 7_000, 91, 1)
    assert (len(waiting), waiting.release()) == (0, [])
    assert waiting.hold(held(5))


@pytest.mark.parametrize(
    ("selection", "taken"),
    [
        (TopicSelection(), {"/odom", "/robot/odom", "/rosout"}),
        (TopicSelection(include_hidden_topics=True), {"/odom", "/robot/odom", "/rosout", "/_hidden", "/a/_b/c"}),
        (TopicSelection(topics=("/odom", "/_hidden")), {"/odom", "/_hidden"}),
        (TopicSelection(regex=".*/odom"), {"/odom", "/robot/odom"}),
        (TopicSelection(regex="/odo"), set()),
        (TopicSelection(topics=("/rosout",), regex="/odom"), {"/rosout", "/odom"}),
        (TopicSelection(exclude_topics=("/odom",)), {"/robot/odom", "/rosout"}),
        (TopicSelection(exclude_regex="/.*odom"), {"/rosout"}),
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


def test_relative_names_belong_to_the_namespace():
    assert [absolute(*names) for names in (("odom",), ("/odom", "/r"), ("odom", "/r"), ("a/b", "/r/s"))] == [
        "/odom",
        "/odom",
        "/r/odom",
        "/r/s/a/b",
    ]
