"""Seek, rate, burst, loops, the fastest replay and reading ahead: a clock of the test, times worked out by hand."""

import heapq
import itertools
import random
import threading

import graph
import pytest
from bag_makers import BEGIN, LATCHED, MS, point, write_mcap
from mcap.reader import make_reader

from diffbot_bag.bag.merged_bags import MergedBags
from diffbot_bag.bag.reader import RawMessage
from diffbot_bag.replay.playback_clock import Window
from diffbot_bag.replay.player import Pace, Player, Sink, Source
from diffbot_bag.replay.read_ahead import ReadAhead

ALL = ("/a", "/b", "/map")


def recorded(count=300):
    """/a every ms, /b with the same times as every third of them, /map at 0, 100 and 250 ms."""
    messages = []
    for index in range(count):
        time = BEGIN + index * MS
        messages.append(("/a", time, point(index)))
        if index % 3 == 0:
            messages.append(("/b", time, point(-index)))
        if index in (0, 100, 250):
            messages.append(("/map", time + 1, point(1000 + index)))
    return messages


class FakeClock:
    """Steady time that passes only in waiting, at once; scripted actions happen when their times come."""

    def __init__(self):
        self.time = 0
        self._script = []
        self._number = itertools.count()

    def at(self, time, action):
        """Call ``action`` at ``time`` [ns]; of equal times, those given first come first."""
        heapq.heappush(self._script, (time, next(self._number), action))

    def now(self):
        return self.time

    def sleep_until(self, target):
        while self._script and self._script[0][0] <= target:
            self._act()
        self.time = max(self.time, target)

    def wait(self, _condition, duration):
        if self._script and (duration is None or self._script[0][0] <= self.time + duration):
            self._act()
        elif duration is None:
            raise AssertionError("waits for something that never comes")
        else:
            self.time += duration

    def _act(self):
        time, _, action = heapq.heappop(self._script)
        self.time = max(self.time, time)
        action()


class Run:
    """A player in this thread; ``sent`` holds steady time and message, ``clock`` steady time and time of the bag."""

    def __init__(self, source, window, **pace):
        self.time = FakeClock()
        self.sent, self.clock, self.hooks = [], [], {}
        self.player = Player(window, source, Sink(self._send, self._tick), Pace(**pace), self.time)

    def _send(self, message):
        self.sent.append((self.time.now(), message))
        self.hooks.get(len(self.sent), lambda: None)()

    def _tick(self, stamp):
        self.clock.append((self.time.now(), stamp))

    def after(self, count, action):
        """Call ``action`` while message number ``count`` is being sent."""
        self.hooks[count] = action

    def play(self):
        self.player.play()
        return [message for _, message in self.sent]


def raw(count=300, period=MS):
    return [RawMessage("/a", point(index), BEGIN + index * period, 0) for index in range(count)]


def plain(messages=None, **pace):
    messages = raw() if messages is None else messages
    source = Source(lambda start: [message for message in messages if message.log_time >= start])
    return Run(source, Window(BEGIN, messages[-1].log_time), **pace)


@pytest.fixture
def bag(tmp_path):
    """A bag of another maker, and what it holds in the order of an independent reader."""
    path = write_mcap(tmp_path / "foreign.mcap", recorded(), offers={"/map": [LATCHED]})
    with path.open("rb") as stream:
        expected = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(stream).iter_messages()]
    bags = MergedBags([path])
    yield bags, expected
    bags.close()


def test_each_seek_goes_on_with_the_very_message_and_the_latched_one_before(bag):
    bags, expected = bag
    source = Source(lambda start: bags.messages(ALL, start, bags.end), lambda start: bags.last_before(start, ["/map"]))
    run = Run(source, Window(bags.start, bags.end))
    generator = random.Random(4)
    # Back and forth, to times of messages, between them, and to both ends of the bag.
    targets = [BEGIN + generator.randrange(300) * MS + generator.choice((-1, 0, 1)) for _ in range(20)]
    targets = [min(max(target, bags.start), bags.end) for target in [*targets, bags.end, bags.start]]
    wanted = expected[:30]
    # Each seek is made while a message is sent, by the last one of the bag if need be.
    for number, target in enumerate(targets):
        run.after(len(wanted), lambda target=target: run.player.seek(target))
        latched = [each for each in expected if each[0] == "/map" and each[1] < target][-1:]
        following = [each for each in expected if each[1] >= target]
        wanted += latched + (following if number == len(targets) - 1 else following[:10])
    assert [(message.topic, message.log_time, message.data) for message in run.play()] == wanted
    assert not run.player.seek(BEGIN)


def test_the_rate_changes_from_now_on():
    run = plain()
    run.time.at(100 * MS, lambda: run.player.set_rate(4.0))
    run.time.at(125 * MS, lambda: run.player.set_rate(0.5))
    run.play()
    # 100 ms at 1, 25 ms at 4 (100 ms of the bag), the rest at 1/2.
    for when, message in run.sent:
        ms = (message.log_time - BEGIN) / MS
        expected = ms if ms <= 100 else 100 + (ms - 100) / 4 if ms <= 200 else 125 + (ms - 200) * 2
        assert when == pytest.approx(expected * MS, abs=2), ms
    assert run.player.progress().rate == 0.5


def test_a_burst_comes_at_once_and_resuming_withdraws_what_is_left_of_it():
    run = plain(start_paused=True)
    run.time.at(10 * MS, lambda: run.player.request_steps(50))
    run.after(20, run.player.resume)
    run.time.at(60 * MS, lambda: run.player.set_rate(2.0))
    run.play()
    times = [when for when, _ in run.sent]
    assert times[:20] == [10 * MS] * 20
    assert times[20:70] == [(10 + index) * MS for index in range(1, 51)]
    assert times[70:] == [60 * MS + index * MS // 2 for index in range(1, 231)]
    assert not run.player.request_steps(1)


def test_the_clock_ticks_in_the_bag_s_time():
    run = plain(rate=2.0, clock=100.0, start_paused=True)
    run.time.at(30 * MS, run.player.resume)
    run.play()
    # While paused, too; from then on 20 ms of the bag at each tick.
    expected = [(when * MS, BEGIN + max(0, when - 30) * 2 * MS) for when in range(0, 180, 10)]
    assert [tick for tick in run.clock if tick[0] < 180 * MS] == expected


def test_a_loop_begins_again_after_the_delay_and_its_clock_jumps_back():
    run = plain(raw(100), loop=True, clock=1000.0, delay=0.01)
    run.after(250, run.player.stop)
    messages = run.play()
    assert [message.data for message in messages] == ([point(index) for index in range(100)] * 3)[:250]
    assert [run.sent[number][0] for number in (0, 99, 100, 200)] == [10 * MS, 109 * MS, 119 * MS, 228 * MS]
    stamps = [stamp for _, stamp in run.clock]
    jumps = [number for number, (one, two) in enumerate(itertools.pairwise(stamps)) if two < one]
    assert len(jumps) == 2
    assert all(stamps[number + 1] == BEGIN for number in jumps)
    assert run.player.progress().rounds == 3


def test_as_fast_as_possible_takes_no_time_keeps_the_order_and_the_clock_is_that_of_the_messages():
    run = plain(rate=0.0, clock=100.0)
    assert run.play() == raw()
    assert run.time.now() == 0
    assert [stamp for _, stamp in run.clock] == [BEGIN + index * MS for index in range(0, 300, 10)]
    assert not run.player.lateness
    assert run.player.progress().bag_time == BEGIN + 299 * MS


@pytest.mark.parametrize("size", [1, 50, 1000])
def test_reading_ahead_keeps_order_and_bound(size):
    drawn = []

    def source():
        for message in raw(3000):
            drawn.append(message)
            yield message

    with ReadAhead(source(), size) as ahead:
        iterator = iter(ahead)
        assert next(iterator).data == point(0)
        # Let it read as far as it wants to.
        graph.wait_for(lambda: len(drawn) >= min(size, 3000), what="reading ahead")
        assert not graph.comes_true(lambda: len(drawn) > size + 150, 0.05)
        assert [message.data for message in iterator] == [point(index) for index in range(1, 3000)]
    # A reader that waits for room ends with the block.
    with ReadAhead(itertools.repeat(drawn[0]), size):
        pass
    assert not any(one.name == "read ahead" for one in threading.enumerate())
