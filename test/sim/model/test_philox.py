"""The random numbers: published answers at their places, and blocks that differ."""

import math

import pytest

from diffbot_sim.model import philox as noise
from diffbot_sim.model.philox import Words, direction, draw, philox, probability

ONES = 0xFFFFFFFF


# The known-answer vectors that the authors of the generator publish with it (Random123, philox4x32, 10 rounds).
@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((ONES, ONES, ONES, ONES), (ONES, ONES), (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    ],
)
def test_published_answers(counter, key, answer):
    assert philox(Words(*counter), *key) == answer


def test_a_draw_is_the_generator_at_its_place():
    """The third known answer. Counter: step, block, run (low word, high word); key: seed (low word, high word)."""
    seed, run = 0x299F31D0A4093822, 0x0370734413198A2E
    words = (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1)
    found = draw(seed, run, 0x243F6A88, 0x85A308D3)
    # The middle of each of 2^32 equal parts of (-1, 1).
    assert found == tuple((word + 0.5) / 2.0**31 - 1.0 for word in words)


def test_the_ends_are_never_reached(monkeypatch):
    monkeypatch.setattr(noise, "philox", lambda *_: Words(0, ONES, 2**31, 2**31 - 1))
    low, high, above, below = draw(1, 2, 3, 4)
    assert low == -1.0 + 2.0**-32
    assert high == 1.0 - 2.0**-32
    assert above == -below == 2.0**-32
    assert 0.0 < probability(low) < probability(high) < 1.0
    assert -math.pi < direction(low) < direction(high) < math.pi


def test_the_blocks_differ():
    blocks = [value for name, value in vars(noise).items() if name.endswith("_BLOCK")]
    assert len(blocks) >= 3
    assert len(set(blocks)) == len(blocks)
