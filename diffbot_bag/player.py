"""Send the messages of a bag on time. Other threads pause, step, seek and stop the player. Does not need ROS."""

from __future__ import annotations

import contextlib
import math
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from diffbot_bag.bag import RawMessage
from diffbot_bag.parameters import ReplayConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.stamps import NS_PER_S

GAP = 60 * NS_PER_S
"""[ns] A longer time without messages is a gap. The player reports gaps, and skips them on request."""
COARSE = 2_000_000
"""[ns] Within this time before a deadline, the player sleeps or spins, and ignores requests of other threads."""
SPIN = 100_000
"""[ns] Within this time before a deadline, the clock spins, since a sleep may end late by this time."""
LONGEST_WAIT = 3600.0
"""[s] longest single wait; a gap may be longer than the longest timeout of a lock"""
LATENESS_SAMPLES = 20_000
"""number of recent messages whose lateness is kept"""
STEP_TIMEOUT = 1.0
"""[s] longest wait of :meth:`Player.step`"""
BATCH, BATCHES = 50, 20
"""Messages per item of the read-ahead queue, and maximum number of items; single messages would be slower."""


class Window(NamedTuple):
    """The part of a bag to play: first and last log time [ns], both included."""

    start: int
    end: int


def window(first: int, last: int, start_offset: float, playback_duration: float) -> Window:
    """Return the part of a bag to play.

    Args:
        first: [ns] log time of the first message.
        last: [ns] log time of the last message.
        start_offset: [s] time from the first message to the start of the part.
        playback_duration: [s] duration of the part; negative: all.

    Raises:
        InvalidValueError: if the offset is longer than the bag.
    """
    start = first + nanoseconds(start_offset)
    if start > last:
        raise InvalidValueError("start_offset", start_offset, f"<= {(last - first) / NS_PER_S:g} s, the bag's length")
    return Window(start, last if playback_duration < 0.0 else min(last, start + nanoseconds(playback_duration)))


def nanoseconds(seconds: float) -> int:
    """Convert [s] to [ns] without a loss of precision."""
    whole = math.floor(seconds)
    # A product of floats would round a time since 1970 to 256 ns.
    return whole * NS_PER_S + round((seconds - whole) * NS_PER_S)


def duration_text(duration: int) -> str:
    """Return a duration [ns] as text in a suitable unit, such as ``56.7 years``."""
    for seconds, unit in ((31_556_952, "years"), (86_400, "days"), (3600, "hours"), (60, "minutes")):
        if duration >= 2 * seconds * NS_PER_S:
            return f"{duration / NS_PER_S / seconds:.1f} {unit}"
    return f"{duration / NS_PER_S:.1f} s"


class Timeline(NamedTuple):
    """Relation of bag time to steady time: bag time is ``bag`` [ns] at steady time ``steady`` [ns].

    From there, bag time advances ``rate`` times as fast as steady time. It does not advance while ``paused``. With a
    rate of 0 every message is due at once, and bag time is the log time of the last message.
    """

    bag: int
    steady: int
    rate: float = 1.0
    paused: bool = False

    def at(self, now: int) -> int:
        """Return the bag time [ns] at steady time ``now`` [ns]."""
        return self.bag if self.paused else self.bag + round((now - self.steady) * self.rate)

    def due(self, log_time: int) -> int:
        """Return the steady time [ns] at which a message is due if the replay is not paused."""
        return self.steady + (round((log_time - self.bag) / self.rate) if self.rate else 0)

    def moved_to(self, now: int) -> Timeline:
        """Return the same timeline with its origin at steady time ``now`` [ns], so that the rate can be changed."""
        return self._replace(bag=self.at(now), steady=now)


class SteadyClock:
    """Steady clock of this machine; tests use another one."""

    def now(self) -> int:
        """Return the steady time [ns]."""
        return time.perf_counter_ns()

    def sleep_until(self, target: int) -> None:
        """Sleep until ``target`` [ns], with an error of a microsecond on an idle processor."""
        if (remaining := target - self.now()) > SPIN:
            time.sleep((remaining - SPIN) / NS_PER_S)
        while self.now() < target:
            pass

    def wait(self, condition: threading.Condition, duration: int | None) -> None:
        """Wait for a notification of ``condition``, for at most ``duration`` [ns]; None: no limit."""
        condition.wait(None if duration is None else min(duration / NS_PER_S, LONGEST_WAIT))


class Progress(NamedTuple):
    """Progress of a replay."""

    bag_time: int
    """[ns] current bag time"""
    sent: int
    """number of messages sent in all rounds, without repeated latched messages"""
    is_paused: bool
    rounds: int
    """number of rounds, including the current one"""
    rate: float
    """bag time per steady time; 0: as fast as possible"""


class Source(NamedTuple):
    """Functions that a player calls to read messages."""

    messages: Callable[[int], Iterable[RawMessage]]
    """returns the messages from a log time [ns] to the end of the window, in the order of log time"""
    latched: Callable[[int], Iterable[RawMessage]] = lambda _: ()
    """returns the earlier latched messages that a subscriber would receive at a log time [ns]"""


class Sink(NamedTuple):
    """Functions that a player calls to send messages, /clock and reports."""

    send: Callable[[RawMessage], None]
    """sends one message; may block until subscribers have acknowledged earlier messages"""
    send_clock: Callable[[int], None]
    """publishes a bag time [ns] on /clock"""
    report_gap: Callable[[int, int], None]
    """reports that the player waits for the end of a gap between two log times [ns]"""


class Player:
    """Sends messages when they are due. :meth:`play` blocks; other threads call the other methods meanwhile."""

    def __init__(
        self, window: Window, source: Source, sink: Sink, config: ReplayConfig, clock: SteadyClock | None = None
    ) -> None:
        """Prepare to play a window of a bag with the settings of ``config``."""
        self.lateness: deque[int] = deque(maxlen=LATENESS_SAMPLES)
        """[ns] delays of recent messages after their due times"""
        self._window, self._source, self._sink = window, source, sink
        self._loop, self._skip_gaps = config.loop, config.skip_gaps
        self._clock = clock or SteadyClock()
        self._tick_period = round(NS_PER_S / config.clock) if config.clock > 0.0 else 0
        self._last_tick: int | None = None
        self._next_bag_tick = 0
        self._changed = threading.Condition()
        rate = 0.0 if config.as_fast_as_possible else config.rate
        self._timeline = Timeline(window.start, self._clock.now(), rate, config.start_paused)
        self._seek_to: int | None = None
        self._stopped = self._ended = False
        self._sent = self._rounds = self._step_until = 0

    def progress(self) -> Progress:
        """Return the progress of the replay."""
        with self._changed:
            timeline = self._timeline
            has_begun = self._rounds > 0 and self._seek_to is None
            bag = timeline.at(self._clock.now()) if has_begun else timeline.bag
            bag = min(max(bag, self._window.start), self._window.end)
            return Progress(bag, self._sent, timeline.paused, self._rounds, timeline.rate)

    @contextlib.contextmanager
    def _change(self) -> Iterator[int]:
        """Hold the lock, yield the steady time [ns], and notify the playing thread at the end."""
        with self._changed:
            yield self._clock.now()
            self._changed.notify_all()

    def pause(self, paused: bool = True) -> None:
        """Pause or resume the replay, and cancel a requested step."""
        with self._change() as now:
            if self._timeline.paused != paused:
                self._timeline = self._timeline.moved_to(now)._replace(paused=paused)
            self._step_until = 0

    def stop(self) -> None:
        """Stop the replay after the current message."""
        with self._change():
            self._stopped = True

    def set_rate(self, rate: float) -> None:
        """Change the rate, which must be > 0."""
        with self._change() as now:
            self._timeline = self._timeline.moved_to(now)._replace(rate=rate)

    def set_skip_gaps(self, skip: bool) -> None:
        """Skip gaps, including the current one, or wait for their end."""
        with self._change():
            self._skip_gaps = skip

    def seek(self, log_time: int) -> bool:
        """Continue with the first message at or after ``log_time`` [ns]; return False if the replay has ended.

        The earlier latched messages are sent first. A paused replay stays paused.
        """
        with self._change() as now:
            if self._ended:
                return False
            self._seek_to, self._step_until = log_time, 0
            self._timeline = self._timeline._replace(bag=log_time, steady=now)
            return True

    def step(self, timeout: float = STEP_TIMEOUT) -> bool:
        """Send the next message of a paused replay; return True if it was sent.

        Args:
            timeout: [s] longest wait until the message is sent; afterwards the request is cancelled. 0: do not wait.
        """
        with self._changed:
            if not self._timeline.paused or self._ended:
                return False
            self._step_until = target = max(self._step_until, self._sent) + 1
            self._changed.notify_all()
            if timeout > 0.0:
                self._changed.wait_for(
                    lambda: self._sent >= target or self._step_until < target or self._ended, timeout
                )
                self._step_until = min(self._step_until, self._sent)
            return self._sent >= target

    def play(self) -> None:
        """Play until the end of the window, or until :meth:`stop` is called.

        Raises:
            DiffbotError: if the bag is damaged.
        """
        try:
            while not self._stopped:
                before = self._sent
                self._rounds += 1
                did_seek = self._play_round()
                # A loop without messages would never wait.
                if not self._loop or (self._sent == before and not did_seek):
                    return
        finally:
            with self._change():
                self._ended = True

    def _play_round(self) -> bool:
        """Play from the start of the window to its end; return True if there was a seek."""
        start, did_seek = self._window.start, False
        while not self._stopped:
            with self._changed:
                if self._seek_to is not None:
                    start, did_seek, self._seek_to = self._seek_to, True, None
            self._play_from(start)
            if self._seek_to is None:
                break
        return did_seek

    def _play_from(self, start: int) -> None:
        """Play from a log time [ns] to the end of the window, or until a stop or a seek."""
        for message in self._source.latched(start):
            self._sink.send(message)
        with read_ahead(self._source.messages(start)) as messages:
            with self._changed:
                if self._seek_to is None:
                    self._timeline = self._timeline._replace(bag=start, steady=self._clock.now())
                    self._next_bag_tick = start
            previous = start
            for message in messages:
                if not self._wait_until_due(message.log_time, previous):
                    return
                previous = message.log_time
                self._sink.send(message)
                with self._change():
                    self._sent += 1

    def _wait_until_due(self, log_time: int, previous: int) -> bool:
        """Publish /clock until a message is due; return False after a stop or a seek."""
        is_gap, is_reported = log_time - previous > GAP, False
        while True:
            with self._changed:
                if self._stopped or self._seek_to is not None:
                    return False
                now, timeline = self._clock.now(), self._timeline
                skips_wait = self._sent < self._step_until if timeline.paused else is_gap and self._skip_gaps
                if skips_wait:
                    self._timeline = timeline._replace(bag=max(timeline.bag, log_time), steady=now)
                    return True
                tick = self._next_tick(now) if self._tick_period else None
                due = None if timeline.paused else timeline.due(log_time)
                if is_gap and not is_reported and due is not None and due - now > NS_PER_S:
                    is_reported = True
                    self._sink.report_gap(previous, log_time)
                target = min((deadline for deadline in (tick, due) if deadline is not None), default=None)
                if target is None or target - now > COARSE:
                    self._clock.wait(self._changed, None if target is None else target - now - COARSE // 2)
                    continue
            self._clock.sleep_until(target)
            if self._stopped or self._timeline is not timeline:
                continue
            if target == tick and target != due:
                self._tick(target)
            elif timeline.rate > 0.0:
                self.lateness.append(self._clock.now() - target)
                return True
            elif self._advance(timeline, log_time):
                return True

    def _advance(self, timeline: Timeline, log_time: int) -> bool:
        """Set bag time to the log time of a message that is due at once; return False if the timeline has changed."""
        with self._changed:
            if self._timeline is not timeline:
                return False
            self._timeline = timeline._replace(bag=max(timeline.bag, log_time))
        if self._tick_period and log_time >= self._next_bag_tick:
            self._next_bag_tick = log_time + self._tick_period
            self._sink.send_clock(log_time)
        return True

    def _next_tick(self, now: int) -> int:
        """Return the steady time [ns] of the next /clock tick; overdue ticks are skipped."""
        if self._last_tick is None:
            return now
        return max(self._last_tick + self._tick_period, now - (now - self._last_tick) % self._tick_period)

    def _tick(self, target: int) -> None:
        self._last_tick = target
        self._sink.send_clock(max(self._timeline.at(target), self._window.start))


@contextlib.contextmanager
def read_ahead(messages: Iterable[RawMessage]) -> Iterator[Iterator[RawMessage]]:
    """Yield an iterator over messages that a thread reads ahead, so that unpacking a chunk does not delay messages.

    The iterator raises the exceptions of the thread. The thread ends at the end of the ``with`` block.
    """
    items: queue.Queue[list[RawMessage] | Exception | None] = queue.Queue(BATCHES)
    stop = threading.Event()

    def read() -> None:
        batch: list[RawMessage] = []
        end: Exception | None = None
        try:
            for message in messages:
                batch.append(message)
                if len(batch) >= BATCH:
                    items.put(batch)
                    batch = []
                if stop.is_set():
                    return
        except Exception as error:  # raised by the iterator, after the messages that were read before
            end = error
        items.put(batch)
        items.put(end)

    def iterate() -> Iterator[RawMessage]:
        while (item := items.get()) is not None:
            if isinstance(item, Exception):
                raise item
            yield from item

    thread = threading.Thread(target=read, name="read ahead", daemon=True)
    thread.start()
    try:
        yield iterate()
    finally:
        stop.set()
        # Empty the queue, because the thread blocks while the queue is full.
        while thread.is_alive():
            with contextlib.suppress(queue.Empty):
                items.get_nowait()
            thread.join(0.01)
