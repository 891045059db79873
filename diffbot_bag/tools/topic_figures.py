"""Figures of one topic from its messages in the order of log time: rate, gap, latency of stamps, lost messages."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from diffbot_bag.record.lost_messages import GapCounter
from diffbot_bag.tools.header_stamps import SIZE, stamps_of
from diffbot_bag.tools.quantiles import Quantiles
from diffbot_core.units import NS_PER_S

_BATCH = 4096


class Latency(NamedTuple):
    """Log time minus stamp [s]; negative for a stamp of the future."""

    smallest: float
    median: float
    p99: float


class TopicFigures(NamedTuple):
    """What :class:`TopicMeter` finds; None where the messages do not tell."""

    message_count: int
    bytes: int
    """of all messages, unpacked"""
    first: int
    """[ns] log time of the first message; 0 without one"""
    last: int
    rate: float | None
    """[Hz] number of intervals over the time from the first to the last message"""
    gap: float | None
    """[s] longest time between neighbouring messages"""
    gap_begin: int | None
    """[ns] log time at which it begins"""
    latency: Latency | None
    """of the messages with a stamp other than 0"""
    unstamped: int | None
    """messages whose stamp is 0 or cannot be read; None if the type has no header"""
    stamps_back: int | None
    """messages whose stamp is earlier than that of the one before"""
    stamp_gap: float | None
    """[s] longest step from one stamp to the next; unlike the gap, it does not grow when the recorder is late"""
    missing: int | None
    """numbers that are missing in the sequence; None if the writer of the bag gave no sequence numbers"""


class TopicMeter:
    """Takes the messages of a topic one by one; its memory does not grow with their number."""

    def __init__(self, is_stamped: bool, publishers: int = 1) -> None:
        """Start without messages.

        Args:
            is_stamped: the type begins with a header.
            publishers: number of them, whose sequence numbers are interleaved.
        """
        self._is_stamped = is_stamped
        self._sequences = GapCounter()
        self._sequences.publishers = publishers
        self._is_numbered = False
        self._waiting: list[tuple[int, int, bytes]] = []
        self._count = self._bytes = self._first = self._last = 0
        self._gap = -1
        self._gap_begin = 0
        self._delays = Quantiles()
        self._last_stamp: int | None = None
        self._stamp_gap: int | None = None
        self._unstamped = self._back = 0

    def add(self, log_time: int, data: bytes, sequence: int = 0) -> None:
        """Add a message, whose log time [ns] is not earlier than that of the one before."""
        self._bytes += len(data)
        self._waiting.append((log_time, sequence, data[:SIZE]))
        if len(self._waiting) >= _BATCH:
            self._flush()

    def _flush(self) -> None:
        if not self._waiting:
            return
        log_times, sequences, heads = zip(*self._waiting, strict=True)
        self._waiting.clear()
        times = np.array(log_times, np.int64)
        if not self._count:
            self._first = self._last = log_times[0]
        gaps = np.diff(times, prepend=self._last)
        # The first message has none before it.
        start = 0 if self._count else 1
        if len(gaps) > start and (gap := int(gaps[start:].max())) > self._gap:
            self._gap = gap
            self._gap_begin = int(times[start + int(gaps[start:].argmax())]) - gap
        self._count += len(times)
        self._last = log_times[-1]
        self._is_numbered = self._is_numbered or any(sequences)
        self._sequences.note_all(sequences)
        if self._is_stamped:
            self._note_stamps(times, list(heads))

    def _note_stamps(self, times: np.ndarray[tuple[int], np.dtype[np.int64]], heads: list[bytes]) -> None:
        stamps = stamps_of(heads)
        known = stamps != 0
        self._unstamped += int(np.count_nonzero(~known))
        stamps = stamps[known]
        if not len(stamps):
            return
        self._delays.add(times[known] - stamps)
        steps = np.diff(stamps) if self._last_stamp is None else np.diff(stamps, prepend=self._last_stamp)
        self._last_stamp = int(stamps[-1])
        if len(steps):
            self._back += int(np.count_nonzero(steps < 0))
            self._stamp_gap = max(int(steps.max()), self._stamp_gap or 0)

    def figures(self) -> TopicFigures:
        """Return the figures of all messages so far."""
        self._flush()
        span = (self._last - self._first) / NS_PER_S
        several, delays = self._count > 1, self._delays
        latency = None
        if delays.count:
            found = (delays.smallest, delays.quantile(0.5), delays.quantile(0.99))
            latency = Latency(*(value / NS_PER_S for value in found))
        return TopicFigures(
            message_count=self._count,
            bytes=self._bytes,
            first=self._first,
            last=self._last,
            rate=(self._count - 1) / span if span > 0.0 else None,
            gap=self._gap / NS_PER_S if several else None,
            gap_begin=self._gap_begin if several else None,
            latency=latency,
            unstamped=self._unstamped if self._is_stamped else None,
            stamps_back=self._back if self._is_stamped else None,
            stamp_gap=None if self._stamp_gap is None else self._stamp_gap / NS_PER_S,
            missing=self._sequences.lost if self._is_numbered else None,
        )
