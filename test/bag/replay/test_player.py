"""Playing in a thread, reading ahead, and waiting for subscribers, with stand-ins for publishers."""

import threading

import graph
import pytest

from diffbot_bag.bag.reader import RawMessage
from diffbot_bag.replay.read_ahead import ReadAhead

BEGIN = 1_700_000_000_000_000_000
MS = 1_000_000


def messages(count, period=MS):
    return [RawMessage("/a", b"%d" % index, BEGIN + index * period, 0) for index in range(count)]


@pytest.mark.parametrize("size", [1, 50, 1000])
def test_reading_ahead_keeps_order_and_bound(size):
    drawn = []

    def source():
        for message in messages(3000):
            drawn.append(message)
            yield message

    with ReadAhead(source(), size) as ahead:
        iterator = iter(ahead)
        assert next(iterator).data == b"0"
        # Let it read as far as it wants to.
        graph.wait_for(lambda: len(drawn) >= min(size, 3000), what="reading ahead")
        assert not graph.comes_true(lambda: len(drawn) > size + 150, 0.05)
        assert [message.data for message in iterator] == [b"%d" % index for index in range(1, 3000)]
    # A reader that waits for room ends with the block.
    before = threading.active_count()
    with ReadAhead(messages(100_000), size):
        pass
    assert threading.active_count() == before
