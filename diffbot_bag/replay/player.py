"""Send the messages of a bag on time; other threads pause, step, seek and stop it. Free of ROS."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

from diffbot_bag.bag.reader import RawMessage
from diffbot_bag.replay.playback_clock import (
    SECOND,
    Timeline,
    Window,
    bag_time,
    due,
    first_tick,
    paused,
    resumed,
    stepped,
    with_rate,
)
from diffbot_bag.replay.read_ahead import ReadAhead
from diffbot_bag.replay.steady_clock import SteadyClock

COARSE = 2_000_000
"""[ns] before a deadline, the player stops waiting for requests of other threads and only sleeps or spins."""
LATENESS_SAMPLES = 20_000
"""Number of recent deadlines whose lateness is kept."""
STEP_TIMEOUT = 1.0
"""[s] maximum wait of :meth:`Player.step`"""


class Progress(NamedTuple):
    """Progress of a replay."""

    bag_time: int
    """[ns]"""
    sent: int
    """messages sent, over all rounds, without the repeated latched ones"""
    is_paused: bool
    rounds: int
    """rounds begun"""
    rate: float
    """bag time per steady time; 0: as fast as possible"""


class Pace(NamedTuple):
    """Speed and course of a replay."""

    rate: float = 1.0
    """2 plays twice as fast; 0: each message is sent as soon as the one before it is"""
    loop: bool = False
    """start again at the end"""
    delay: float = 0.0
    """[s] wait before each round"""
    start_paused: bool = False
    """start paused"""
    clock: float = 0.0
    """[Hz] rate of /clock, also while paused; of the bag's time if ``rate`` is 0; 0: no /clock"""
    read_ahead: int = 1000
    """messages read in advance"""


class Source(NamedTuple):
    """Where a player has its messages from."""

    messages: Callable[[int], Iterable[RawMessage]]
    """messages from a log time [ns] on, itself included, to the end of the window, in the order of log time"""
    latched: Callable[[int], Iterable[RawMessage]] = lambda _: ()
    """messages before a log time [ns] that a late subscriber would have: sent before the first one from there on"""


class Sink(NamedTuple):
    """Where a player sends its messages."""

    send: Callable[[RawMessage], None]
    """sends one message; may block until there is room for it"""
    send_clock: Callable[[int], None] | None = None
    """publishes a time of the bag [ns] on /clock"""


class Player:
    """Sends messages when they are due; :meth:`play` blocks its thread, the other methods are for other threads."""

    def __init__(
        self, window: Window, source: Source, sink: Sink, pace: Pace | None = None, clock: SteadyClock | None = None
    ) -> None:
        """Prepare the replay of a window, the part of the bag to play."""
        self.lateness: deque[int] = deque(maxlen=LATENESS_SAMPLES)
        """[ns] delays of recent messages behind their due times"""
        self._window, self._source, self._sink = window, source, sink
        self._pace = pace = pace or Pace()
        self._clock = clock or SteadyClock()
        self._tick_period = round(SECOND / pace.clock) if pace.clock > 0.0 and sink.send_clock else 0
        self._last_tick: int | None = None
        self._next_bag_tick = 0
        self._changed = threading.Condition()
        self._timeline = Timeline(window.start, self._clock.now(), pace.rate, pace.start_paused)
        self._seek_to: int | None = None
        self._stopped = False
        self._ended = False
        self._sent = 0
        self._rounds = 0
        self._steps_requested = 0
        self._steps_done = 0

    def progress(self) -> Progress:
        """Return the progress of the replay."""
        with self._changed:
            has_begun = self._rounds > 0 and self._seek_to is None
            begun = bag_time(self._timeline, self._clock.now()) if has_begun else self._timeline.bag
            now = min(max(begun, self._window.start), self._window.end)
            return Progress(now, self._sent, self._timeline.paused, self._rounds, self._timeline.rate)

    def pause(self) -> None:
        """Pause the replay."""
        with self._changed:
            self._timeline = paused(self._timeline, self._clock.now())
            self._changed.notify_all()

    def resume(self) -> None:
        """Resume the replay; steps that were requested and not sent yet are withdrawn."""
        with self._changed:
            self._timeline = resumed(self._timeline, self._clock.now())
            self._withdraw_steps()

    def toggle_paused(self) -> bool:
        """Pause or resume; return whether the replay is now paused."""
        with self._changed:
            if self._timeline.paused:
                self.resume()
            else:
                self.pause()
            return self._timeline.paused

    def stop(self) -> None:
        """Stop the replay after the message that is being sent."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def set_rate(self, rate: float) -> None:
        """Play at another rate, > 0, from now on."""
        with self._changed:
            self._timeline = with_rate(self._timeline, self._clock.now(), rate)
            self._changed.notify_all()

    def seek(self, time: int) -> bool:
        """Continue with the first message at or after ``time`` [ns], of the window; return False after the end.

        At most the message that is being sent still comes; then the latched ones of before, then the one sought. A
        paused replay stays paused.
        """
        with self._changed:
            if self._ended:
                return False
            self._seek_to = time
            self._timeline = self._timeline._replace(bag=time, steady=self._clock.now())
            self._withdraw_steps()
            return True

    def request_steps(self, count: int) -> int:
        """Let a paused replay send its next ``count`` messages; return the number of the last step, 0 if not paused."""
        with self._changed:
            if not self._timeline.paused or self._ended:
                return 0
            self._steps_requested += count
            self._changed.notify_all()
            return self._steps_requested

    def step(self, count: int = 1, timeout: float = STEP_TIMEOUT) -> int:
        """Send the next messages of a paused replay; return how many were sent, 0 if it is not paused.

        Args:
            count: of messages.
            timeout: [s] maximum wait until they are sent; what is left is not sent later.
        """
        with self._changed:
            last = self.request_steps(count)
            if last == 0:
                return 0
            self._changed.wait_for(
                lambda: self._steps_done >= last or self._steps_requested < last or self._ended, timeout
            )
            left = max(0, last - self._steps_done)
            self._withdraw_steps()
            return max(0, count - left)

    def _withdraw_steps(self) -> None:
        self._steps_requested = self._steps_done
        self._changed.notify_all()

    def play(self) -> None:
        """Play until the end or :meth:`stop`.

        Raises:
            DiffbotError: if the bag is damaged.
        """
        try:
            while not self._stopped:
                before = self._sent
                is_whole = self._play_round()
                # Without messages a loop would never wait.
                if not self._pace.loop or (is_whole and self._sent == before):
                    return
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _play_round(self) -> bool:
        """Play from the start of the window to its end; return False if it was left by a seek."""
        with self._changed:
            self._rounds += 1
        start, delay, is_whole = self._window.start, round(self._pace.delay * SECOND), True
        while not self._stopped:
            with self._changed:
                if self._seek_to is not None:
                    start, delay, is_whole = self._seek_to, 0, False
                    self._seek_to = None
            self._play_from(start, delay)
            with self._changed:
                if self._seek_to is None:
                    break
        return is_whole

    def _play_from(self, start: int, delay: int) -> None:
        """Play from a log time [ns] until the end, a stop or a seek; first wait for ``delay`` [ns]."""
        for message in self._source.latched(start):
            self._sink.send(message)
        with ReadAhead(self._source.messages(start), self._pace.read_ahead) as messages:
            with self._changed:
                if self._seek_to is None:
                    # During the delay the bag's time lies before the start.
                    self._timeline = self._timeline._replace(bag=start, steady=self._clock.now() + delay)
                    self._next_bag_tick = start
            for message in messages:
                if not self._wait_until_due(message.log_time):
                    return
                self._sink.send(message)
                with self._changed:
                    self._sent += 1
                    self._changed.notify_all()

    def _wait_until_due(self, log_time: int) -> bool:
        """Wait until a message is due and publish /clock meanwhile; return False after a stop or a seek."""
        while True:
            with self._changed:
                if self._stopped or self._seek_to is not None:
                    return False
                if self._timeline.paused and self._steps_requested > self._steps_done:
                    self._steps_done += 1
                    self._timeline = stepped(self._timeline, log_time)
                    return True
                now, timeline = self._clock.now(), self._timeline
                tick = self._next_tick(now)
                message = None if timeline.paused else due(timeline, log_time)
                target = min((time for time in (tick, message) if time is not None), default=None)
                if target is None or target - now > COARSE:
                    self._clock.wait(self._changed, None if target is None else target - now - COARSE // 2)
                    continue
            self._clock.sleep_until(target)
            if self._stopped or self._timeline is not timeline:
                continue
            if target == tick and target != message:
                self._tick(target)
                continue
            if timeline.rate > 0.0:
                self.lateness.append(self._clock.now() - target)
                return True
            if self._advance(timeline, log_time):
                return True

    def _advance(self, timeline: Timeline, log_time: int) -> bool:
        """Move the bag's time on to a message that is sent as fast as possible; return False if something changed."""
        with self._changed:
            if self._timeline is not timeline:
                return False
            self._timeline = stepped(timeline, log_time)
        if self._tick_period and self._sink.send_clock and log_time >= self._next_bag_tick:
            self._next_bag_tick = log_time + self._tick_period
            self._sink.send_clock(log_time)
        return True

    def _next_tick(self, now: int) -> int | None:
        return first_tick(now, self._tick_period, self._last_tick) if self._tick_period else None

    def _tick(self, target: int) -> None:
        if self._sink.send_clock is not None:
            self._last_tick = target
            self._sink.send_clock(max(bag_time(self._timeline, target), self._window.start))
