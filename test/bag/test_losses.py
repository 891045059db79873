"""Lost messages counted by sequence numbers: several publishers, suspected gaps, restarts."""

import random

import pytest

from diffbot_bag.losses import LossCounter


def lost(numbers, publishers=1):
    losses = LossCounter(lambda: publishers)
    for number in numbers:
        losses.note(number)
    return losses.lost


@pytest.mark.parametrize(
    ("numbers", "publishers", "expected"),
    [
        ([1, 2, 5], 1, 2),
        # The publisher was replaced by a new one, which counts from 1.
        ([5, 6, 1, 2, 4], 1, 1),
        ([1, 101, 2, 102, 3, 105, 4, 106, 9], 2, 2 + 4),
        # A second publisher that never sends hides no gap, whatever its size.
        ([1, 2, 3, 50, 51], 2, 46),
        ([1, 2, 3, 10_000, 10_001, 10_005], 3, 9996 + 3),
        # A suspected gap is withdrawn when the first publisher goes on.
        ([1, 2, 3, 50, 51, 4, 52, 5], 2, 0),
    ],
)
def test_gaps_count_until_they_turn_out_to_be_another_publisher(numbers, publishers, expected):
    assert lost(numbers, publishers) == expected


@pytest.mark.parametrize("publishers", [2, 3, 8])
@pytest.mark.parametrize("probability", [0.0, 0.01])
def test_losses_of_several_interleaved_publishers_are_exact(publishers, probability):
    generator = random.Random(publishers)
    following = [generator.randrange(1000) for _ in range(publishers)]
    numbers, expected = following.copy(), 0
    for index in range(4000):
        sender = generator.randrange(publishers)
        following[sender] += 1
        # The last messages come: without a following message, no number shows a loss.
        if index < 3800 and generator.random() < probability:
            expected += 1
        else:
            numbers.append(following[sender])
    assert lost(numbers, publishers) == expected
