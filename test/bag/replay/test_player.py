"""Playing in a thread, reading ahead, and waiting for subscribers, with stand-ins for publishers."""

import threading
import time

import graph
import pytest

from diffbot_bag.bag.reader import RawMessage
from diffbot_bag.replay.playback_clock import Window
from diffbot_bag.replay.player import Pace, Player, Sink, Source
from diffbot_bag.replay.read_ahead import ReadAhead

BEGIN = 1_700_000_000_000_000_000
MS = 1_000_000


def messages(count, period=MS):
    return [RawMessage("/a", b"%d" % index, BEGIN + index * period, 0) for index in range(count)]


class Run:
    """A player in its thread, and what it sent."""

    def __init__(self, source, **pace):
        self.sent = []
        sink = Sink(lambda message: self.sent.append((time.perf_counter_ns(), message.data)))
        self.player = Player(Window(BEGIN, BEGIN + 10**9), Source(lambda _start: source()), sink, Pace(**pace))
        self.thread = threading.Thread(target=self.player.play)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.player.stop()
        self.thread.join(graph.PATIENCE)
        assert not self.thread.is_alive()


def test_messages_are_sent_in_order_and_none_too_early():
    began = time.perf_counter_ns()
    with Run(lambda: messages(50, 2 * MS), rate=2.0) as run:
        run.thread.join(graph.PATIENCE)
    assert [data for _, data in run.sent] == [b"%d" % index for index in range(50)]
    assert all(when >= began + index * MS for index, (when, _) in enumerate(run.sent))
    assert min(run.player.lateness) >= 0
    assert run.player.progress().sent == 50


def test_a_step_that_found_nothing_is_not_made_later():
    release = threading.Event()

    def slow():
        release.wait(10.0)
        yield from messages(5)

    with Run(slow, start_paused=True) as run:
        assert not run.player.step(timeout=0.02)
        release.set()
        assert not graph.comes_true(lambda: run.sent, 0.1)


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
