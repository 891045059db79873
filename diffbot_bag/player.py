"""Send the messages of a bag on time; can be paused, stepped and stopped from other threads. Free of ROS."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

from diffbot_bag.playback_clock import (
    SECOND,
    Timeline,
    Window,
    bag_time,
    due,
    first_tick,
    paused,
    resumed,
    stepped,
)
from diffbot_bag.read_ahead import ReadAhead
from diffbot_bag.reader import RawMessage

LONGEST_WAIT = 3600.0
"""[s] A gap in a bag may be longer than a lock can wait."""
COARSE = 2_000_000
"""[ns] before a deadline, the player stops waiting for requests of other threads and only sleeps or spins."""
SPIN = 100_000
"""[ns] before a deadline, the player spins instead of sleeping, since a sleep ends about that late."""
LATENESS_SAMPLES = 20_000
"""Number of recent deadlines whose lateness is kept."""
_now = time.perf_counter_ns


class Progress(NamedTuple):
    """Progress of a replay."""

    bag_time: int
    """[ns]"""
    sent: int
    """messages sent, over all rounds"""
    is_paused: bool
    rounds: int
    """rounds begun"""


class Pace(NamedTuple):
    """Speed and course of a replay."""

    rate: float = 1.0
    """2 plays twice as fast"""
    loop: bool = False
    """start again at the end"""
    delay: float = 0.0
    """[s] wait before each round"""
    start_paused: bool = False
    """start paused"""
    clock: float = 0.0
    """[Hz] rate of /clock, also while paused; 0: no /clock"""
    read_ahead: int = 1000
    """messages read in advance"""


class Player:
    """Sends messages when they are due; :meth:`play` blocks its thread, the other methods are for other threads."""

    def __init__(
        self,
        window: Window,
        messages: Callable[[], Iterable[RawMessage]],
        send: Callable[[RawMessage], None],
        pace: Pace | None = None,
        send_clock: Callable[[int], None] | None = None,
    ) -> None:
        """Prepare the replay of a window.

        Args:
            window: part of the bag to play.
            messages: called once per round; returns the messages of the window in the order of log time.
            send: sends one message.
            pace: speed and course.
            send_clock: publishes a time of the bag [ns] on /clock.
        """
        self.lateness: deque[int] = deque(maxlen=LATENESS_SAMPLES)
        """[ns] delays of recent messages behind their due times"""
        self._window = window
        self._messages = messages
        self._send = send
        self._pace = pace = pace or Pace()
        self._send_clock = send_clock
        self._tick_period = round(SECOND / pace.clock) if pace.clock > 0.0 and send_clock else 0
        self._last_tick: int | None = None
        self._changed = threading.Condition()
        self._timeline = Timeline(window.start, _now(), pace.rate, pace.start_paused)
        self._stopped = False
        self._ended = False
        self._sent = 0
        self._rounds = 0
        self._steps_requested = 0
        self._steps_done = 0

    def progress(self) -> Progress:
        """Return the progress of the replay."""
        with self._changed:
            begun = bag_time(self._timeline, _now()) if self._rounds else self._window.start
            now = min(max(begun, self._window.start), self._window.end)
            return Progress(now, self._sent, self._timeline.paused, self._rounds)

    def pause(self) -> None:
        """Pause the replay."""
        with self._changed:
            self._timeline = paused(self._timeline, _now())
            self._changed.notify_all()

    def resume(self) -> None:
        """Resume the replay."""
        with self._changed:
            self._timeline = resumed(self._timeline, _now())
            self._changed.notify_all()

    def toggle_paused(self) -> bool:
        """Pause or resume; return whether the replay is now paused."""
        with self._changed:
            change = resumed if self._timeline.paused else paused
            self._timeline = change(self._timeline, _now())
            self._changed.notify_all()
            return self._timeline.paused

    def stop(self) -> None:
        """Stop the replay after the message that is being sent."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def play_next(self, timeout: float = 1.0) -> bool:
        """Send the next message of a paused replay; return False if it is not paused or no message is left.

        Args:
            timeout: [s] maximum wait until it is sent.
        """
        with self._changed:
            if not self._timeline.paused or self._ended:
                return False
            self._steps_requested += 1
            number = self._steps_requested
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._steps_done >= number or self._ended, timeout)
            # Withdraw a request that timed out, so that its message is not sent later.
            self._steps_requested = min(self._steps_requested, self._steps_done)
            return self._steps_done >= number

    def play(self) -> None:
        """Play until the end or :meth:`stop`.

        Raises:
            DiffbotError: if the bag is damaged.
        """
        try:
            while not self._stopped:
                before = self._sent
                self._play_round()
                # Without messages a loop would never wait.
                if not self._pace.loop or self._sent == before:
                    return
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _play_round(self) -> None:
        with ReadAhead(self._messages(), self._pace.read_ahead) as messages:
            with self._changed:
                self._rounds += 1
                self._timeline = self._timeline._replace(
                    bag=self._window.start, steady=_now() + round(self._pace.delay * SECOND)
                )
            # During the delay the bag's time lies before the start of the window.
            for message in messages:
                if not self._wait_until_due(message.log_time):
                    return
                self._send(message)
                with self._changed:
                    self._sent += 1
                    self._changed.notify_all()

    def _wait_until_due(self, log_time: int) -> bool:
        """Wait until a message is due and publish /clock meanwhile; return False if the replay was stopped."""
        while True:
            with self._changed:
                if self._stopped:
                    return False
                if self._timeline.paused and self._steps_requested > self._steps_done:
                    self._steps_done += 1
                    self._timeline = stepped(self._timeline, log_time)
                    return True
                now, timeline = _now(), self._timeline
                tick = self._next_tick(now)
                message = None if self._timeline.paused else due(self._timeline, log_time)
                target = min((time for time in (tick, message) if time is not None), default=None)
                if target is None:
                    self._changed.wait()
                    continue
                if target - now > COARSE:
                    self._changed.wait(min((target - now - COARSE // 2) / SECOND, LONGEST_WAIT))
                    continue
            self._sleep_until(target)
            if self._stopped or self._timeline is not timeline:
                continue
            if target == tick and target != message:
                self._tick(target)
                continue
            self.lateness.append(_now() - target)
            return True

    def _sleep_until(self, target: int) -> None:
        remaining = target - _now()
        if remaining > SPIN:
            time.sleep((remaining - SPIN) / SECOND)
        while _now() < target:
            pass

    def _next_tick(self, now: int) -> int | None:
        return first_tick(now, self._tick_period, self._last_tick) if self._tick_period else None

    def _tick(self, target: int) -> None:
        if self._send_clock is not None:
            self._last_tick = target
            self._send_clock(max(bag_time(self._timeline, target), self._window.start))
