"""Play messages in time: a thread's loop that can be paused, stepped and stopped from other threads; free of ROS."""

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

COARSE = 2_000_000
"""[ns] before a deadline up to which the player can be woken; after that it only sleeps and spins."""
SPIN = 100_000
"""[ns] before a deadline in which the player does not sleep: about what a sleep is late."""
LATENESS_SAMPLES = 20_000
"""Newest deadlines of which the lateness is kept."""
_now = time.perf_counter_ns


class Progress(NamedTuple):
    """How far a replay has come."""

    bag_time: int
    """[ns]"""
    sent: int
    """Messages sent in all rounds."""
    is_paused: bool
    rounds: int
    """Rounds begun."""


class Pace(NamedTuple):
    """How a bag is played."""

    rate: float = 1.0
    """Speed; 2 plays twice as fast."""
    loop: bool = False
    """Begin again at the end."""
    delay: float = 0.0
    """[s] to wait before each round."""
    start_paused: bool = False
    """Begin with the bag's time standing still."""
    clock: float = 0.0
    """[Hz] of /clock, paused or not; 0 for none."""
    read_ahead: int = 1000
    """Messages kept ready."""


class Player:
    """Sends messages when they are due; ``play`` runs in a thread of its own, the rest is for other threads."""

    def __init__(
        self,
        window: Window,
        messages: Callable[[], Iterable[RawMessage]],
        send: Callable[[RawMessage], None],
        pace: Pace | None = None,
        send_clock: Callable[[int], None] | None = None,
    ) -> None:
        """Prepare to play.

        Args:
            window: part of the bag to play; its start is where the bag's time begins.
            messages: returns the messages of the window in the order of log time, anew for each round.
            send: sends one message.
            pace: how to play.
            send_clock: sends a time of the bag [ns].
        """
        self.lateness: deque[int] = deque(maxlen=LATENESS_SAMPLES)
        """[ns] by which the newest messages were sent after they were due."""
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
        self._steps_wanted = 0
        self._steps_done = 0

    def progress(self) -> Progress:
        """Tell how far the replay has come."""
        with self._changed:
            begun = bag_time(self._timeline, _now()) if self._rounds else self._window.start
            now = min(max(begun, self._window.start), self._window.end)
            return Progress(now, self._sent, self._timeline.paused, self._rounds)

    def pause(self) -> None:
        """Let the bag's time stand still."""
        with self._changed:
            self._timeline = paused(self._timeline, _now())
            self._changed.notify_all()

    def resume(self) -> None:
        """Let the bag's time run on."""
        with self._changed:
            self._timeline = resumed(self._timeline, _now())
            self._changed.notify_all()

    def toggle_paused(self) -> bool:
        """Pause or resume; return True if the replay is paused now."""
        with self._changed:
            change = resumed if self._timeline.paused else paused
            self._timeline = change(self._timeline, _now())
            self._changed.notify_all()
            return self._timeline.paused

    def stop(self) -> None:
        """End the replay after the message that is being sent."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def play_next(self, timeout: float = 1.0) -> bool:
        """Send the next message of a paused replay; False if there was none.

        Args:
            timeout: [s] to wait for it.
        """
        with self._changed:
            if not self._timeline.paused or self._ended:
                return False
            self._steps_wanted += 1
            number = self._steps_wanted
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._steps_done >= number or self._ended, timeout)
            # A step that did not come in time must not come as a surprise later.
            self._steps_wanted = min(self._steps_wanted, self._steps_done)
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
                # A part of the bag without messages would be played over and over at full speed.
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
            # The delay is a stretch in which the bag's time has not yet come to its start.
            for message in messages:
                if not self._wait_until_due(message.log_time):
                    return
                self._send(message)
                with self._changed:
                    self._sent += 1
                    self._changed.notify_all()

    def _wait_until_due(self, log_time: int) -> bool:
        """Wait, and tick the clock meanwhile; False if the replay was stopped."""
        while True:
            with self._changed:
                if self._stopped:
                    return False
                if self._timeline.paused and self._steps_wanted > self._steps_done:
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
                    self._changed.wait((target - now - COARSE // 2) / SECOND)
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
