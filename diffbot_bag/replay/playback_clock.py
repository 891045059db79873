"""Time in a replay: the part of the bag that is played and when each message is due; pure functions."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.errors import InvalidValueError

SECOND = 10**9
"""[ns]"""


class Window(NamedTuple):
    """The part of a bag that is played: log times [ns], both ends included."""

    start: int
    end: int


def window(
    first: int,
    last: int,
    start_offset: float = 0.0,
    playback_duration: float = -1.0,
    playback_until: float = -1.0,
) -> Window:
    """Return the part to play of a bag with messages from ``first`` to ``last`` [ns].

    Args:
        first: log time [ns] of the first message.
        last: log time [ns] of the last message.
        start_offset: [s] of the bag to skip.
        playback_duration: [s] of the bag to play after the offset; negative for all.
        playback_until: [s] time of the bag at which to end; negative for none. The earlier end counts.

    Raises:
        InvalidValueError: if no part of the bag remains.
    """
    start = first + nanoseconds(start_offset)
    if start > last:
        raise InvalidValueError("start_offset", start_offset, f"<= {(last - first) / SECOND:g} s, the bag's length")
    end = last
    if playback_duration >= 0.0:
        end = min(end, start + nanoseconds(playback_duration))
    if playback_until >= 0.0:
        end = min(end, nanoseconds(playback_until))
    if end < start:
        bound = f">= {start / SECOND:.9f} s, where the replay begins"
        raise InvalidValueError("playback_until", playback_until, bound)
    return Window(start, end)


def nanoseconds(seconds: float) -> int:
    """Return a time [s] as [ns]; a time since 1970 keeps the digits that its float has."""
    whole = math.floor(seconds)
    # Multiplied as one float, a time since 1970 would be rounded to 256 ns.
    return whole * SECOND + round((seconds - whole) * SECOND)


class Timeline(NamedTuple):
    """Relation of the bag's time to steady time: at ``steady`` [ns] the bag is at ``bag`` [ns].

    From there on the bag's time advances ``rate`` times as fast as steady time, and not at all while ``paused``. With a
    rate of 0 every message is due at once, and the bag's time is that of the last one sent (:func:`stepped`).
    """

    bag: int
    steady: int
    rate: float = 1.0
    paused: bool = False


def bag_time(timeline: Timeline, now: int) -> int:
    """Return the time of the bag [ns] at steady time ``now`` [ns]."""
    if timeline.paused:
        return timeline.bag
    return timeline.bag + round((now - timeline.steady) * timeline.rate)


def due(timeline: Timeline, log_time: int) -> int:
    """Return the steady time [ns] at which a message is due, provided that the replay is not paused before."""
    if timeline.rate == 0.0:
        return timeline.steady
    return timeline.steady + round((log_time - timeline.bag) / timeline.rate)


def paused(timeline: Timeline, now: int) -> Timeline:
    """Return the timeline paused at steady time ``now`` [ns]."""
    return timeline._replace(bag=bag_time(timeline, now), steady=now, paused=True)


def resumed(timeline: Timeline, now: int) -> Timeline:
    """Return the timeline resumed at steady time ``now`` [ns]; unchanged if it is not paused."""
    return timeline._replace(steady=now, paused=False) if timeline.paused else timeline


def stepped(timeline: Timeline, log_time: int) -> Timeline:
    """Return a timeline that stands still (paused, or of rate 0) advanced to a message that is sent."""
    return timeline._replace(bag=max(timeline.bag, log_time))


def with_rate(timeline: Timeline, now: int, rate: float) -> Timeline:
    """Return the timeline with another rate from steady time ``now`` [ns] on; a delay before its begin stays."""
    if now < timeline.steady:
        return timeline._replace(rate=rate)
    return timeline._replace(bag=bag_time(timeline, now), steady=now, rate=rate)


def first_tick(now: int, period: int, last: int | None) -> int:
    """Return the steady time [ns] of the next /clock tick after the one at ``last``; overdue ticks are skipped."""
    if last is None:
        return now
    return max(last + period, now - (now - last) % period)


def parse_remap(rules: tuple[str, ...]) -> dict[str, str]:
    """Return the absolute names ``{old: new}`` of rules ``old:=new``.

    Raises:
        InvalidValueError: if a rule does not have this form.
    """
    names = {}
    for rule in rules:
        old, arrow, new = rule.partition(":=")
        if not (old and arrow and new):
            raise InvalidValueError("remap", rule, "old:=new")
        names[f"/{old.lstrip('/')}"] = f"/{new.lstrip('/')}"
    return names
