"""Seek, rate, gaps, loops and the fastest replay, with a fake clock and times computed by hand."""

import heapq
import itertools
import random

import pytest
from bag_makers import BEGIN, MS, point, string

from diffbot_bag.bag import RawMessage
from diffbot_bag.parameters import ReplayConfig
from diffbot_bag.player import Player, Sink, Source, Window

HOUR = 3600 * 1000 * MS


class FakeClock:
    """Steady clock that advances only while the player waits; scripted actions are called at their times."""

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
            raise AssertionError("the player waits without a limit")
        else:
            self.time += duration

    def _act(self):
        time, _, action = heapq.heappop(self._script)
        self.time = max(self.time, time)
        action()


class Run:
    """A player in this thread. ``sent`` has steady times and messages, ``clock`` has steady times and bag times."""

    def __init__(self, source, window, **config):
        self.time = FakeClock()
        self.sent, self.clock, self.gaps, self.hooks = [], [], [], {}
        sink = Sink(self._send, self._tick, lambda start, end: self.gaps.append((self.time.now(), start, end)))
        self.player = Player(window, source, sink, ReplayConfig(**config), self.time)

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


def raw(count=300, period=MS, begin=BEGIN):
    return [RawMessage("/a", point(index), begin + index * period, 0, 0) for index in range(count)]


def plain(messages=None, **config):
    messages = raw() if messages is None else messages
    source = Source(lambda start: [message for message in messages if message.log_time >= start])
    return Run(source, Window(BEGIN, messages[-1].log_time), **config)


def test_a_seek_continues_at_the_exact_message_after_the_earlier_latched_one():
    latched = [RawMessage("/map", string(str(time)), BEGIN + time * MS + 1, 0, 0) for time in (0, 100, 250)]
    messages = sorted([*raw(), *latched], key=lambda message: message.log_time)

    def from_time(start):
        return [message for message in messages if message.log_time >= start]

    def latched_before(start):
        return [message for message in latched if message.log_time < start][-1:]

    first, last = messages[0].log_time, messages[-1].log_time
    run = Run(Source(from_time, latched_before), Window(first, last))
    generator = random.Random(4)
    # Seek back and forth, to times of messages, to times between messages, and to both ends of the bag.
    targets = [BEGIN + generator.randrange(300) * MS + generator.choice((-1, 0, 1)) for _ in range(20)]
    targets = [min(max(target, first), last) for target in [*targets, last, first]]
    expected = messages[:30]
    # Each seek is called while a message is sent.
    for number, target in enumerate(targets):
        run.after(len(expected), lambda target=target: run.player.seek(target))
        expected += latched_before(target) + from_time(target)[: 10 if number < len(targets) - 1 else None]
    assert run.play() == expected
    assert not run.player.seek(BEGIN)


def test_a_changed_rate_holds_from_that_time_on():
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


def test_a_pause_stops_time_and_steps_send_one_message_each():
    run = plain(raw(100))
    run.time.at(40 * MS + 1, run.player.pause)
    for index in range(3):
        run.time.at((50 + index) * MS, lambda: run.player.step(timeout=0.0))
    run.time.at(60 * MS, lambda: run.player.pause(False))
    assert run.play() == raw(100)
    times = [when for when, _ in run.sent]
    assert times[40:44] == [40 * MS, 50 * MS, 51 * MS, 52 * MS]
    # Message 43 was the last step: the bag's time goes on from there.
    assert times[44:] == [60 * MS + (index + 1) * MS for index in range(56)]


def test_a_gap_is_reported_once_and_waited_for():
    messages = raw(10) + raw(10, begin=BEGIN + HOUR)
    run = plain(messages)
    assert run.play() == messages
    assert run.gaps == [(9 * MS, BEGIN + 9 * MS, BEGIN + HOUR)]
    assert run.sent[10][0] == HOUR


@pytest.mark.parametrize("request_time", [0, 500 * MS])
def test_a_gap_is_skipped_on_request_before_or_during_it(request_time):
    messages = raw(10) + raw(10, begin=BEGIN + HOUR)
    run = plain(messages, clock=100.0, skip_gaps=request_time == 0)
    run.time.at(request_time, lambda: run.player.set_skip_gaps(True))
    assert run.play() == messages
    begin = max(request_time, 9 * MS)
    assert [when for when, _ in run.sent[10:]] == [begin + index * MS for index in range(10)]
    stamps = [stamp for _, stamp in run.clock]
    assert stamps == sorted(stamps)


def test_a_loop_repeats_the_messages_and_sets_the_clock_back():
    run = plain(raw(100), loop=True, clock=1000.0)
    run.after(250, run.player.stop)
    messages = run.play()
    assert [message.data for message in messages] == ([point(index) for index in range(100)] * 3)[:250]
    assert [run.sent[number][0] for number in (0, 99, 100, 200)] == [0, 99 * MS, 99 * MS, 198 * MS]
    stamps = [stamp for _, stamp in run.clock]
    jumps = [number for number, (one, two) in enumerate(itertools.pairwise(stamps)) if two < one]
    assert len(jumps) == 2
    assert run.player.progress().rounds == 3


def test_as_fast_as_possible_does_not_wait_and_the_clock_follows_the_messages():
    messages = raw() + raw(10, begin=BEGIN + HOUR)
    run = plain(messages, as_fast_as_possible=True, clock=100.0)
    assert run.play() == messages
    assert run.time.now() == 0
    assert not run.gaps
    assert [stamp for _, stamp in run.clock] == [*(BEGIN + index * MS for index in range(0, 300, 10)), BEGIN + HOUR]
    assert not run.player.lateness
    assert run.player.progress().bag_time == BEGIN + HOUR + 9 * MS
