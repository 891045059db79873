"""What a damaged file has lost: counted while it is read, as far as what is left of it says so."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from diffbot_bag.mcap.format import McapSummary, index_entries
from diffbot_bag.mcap.scan import Gap, Piece
from diffbot_core.errors import DiffbotError
from diffbot_core.units import NS_PER_S

MAX_GAPS = 100_000
_PLAUSIBLE = 24 * 3600 * NS_PER_S
"""[ns] between a chunk whose head may be damaged and its neighbours"""


class Span(NamedTuple):
    """Log times [ns] between which messages are missing; None: unknown."""

    start: int | None
    end: int | None


UNKNOWN = Span(None, None)


class Loss(NamedTuple):
    """What is missing of a file."""

    chunks: int = 0
    """Damaged chunks."""
    bytes: int = 0
    """Of the file that could not be read."""
    messages: Mapping[str, int] = {}
    """Lost messages by topic, as far as known."""
    is_exact: bool = False
    """The counts come from the index of the file: nothing else is missing."""
    spans: tuple[Span, ...] = ()
    """Times of the damaged chunks and of places that cannot be read."""
    is_cut: bool = False
    """The file ends within a record, or without its index."""
    unverified: int = 0
    """Messages saved from the chunk within which the file ends; its checksum covers the whole chunk only."""
    doubtful: tuple[str, ...] = ()
    """Topics whose name and type could only be taken from a damaged chunk."""
    without_qos: tuple[str, ...] = ()
    """Topics whose QoS cannot be read, and is left out."""
    unknown: tuple[str, ...] = ()
    """Made-up topics of channels that nothing describes any more."""
    beyond: int = 0
    """Messages left out, since their log time is beyond MAX_TIME: no command could read the bag."""


@dataclass
class _Missing:
    gap: Gap
    head: Span
    """As the head of a chunk says."""
    before: int | None
    after: int | None = None
    counts: Counter[int] = field(default_factory=Counter)
    times: list[int] = field(default_factory=list)

    def span(self) -> Span:
        if self.times:
            return Span(min(self.times), max(self.times))
        near = [time for time in (self.before, self.after) if time is not None]
        start, end = self.head
        if start is None or end is None or start > end or not near:
            return Span(self.before, self.after)
        is_near = all(abs(time - other) < _PLAUSIBLE for time in near for other in (start, end))
        return self.head if is_near else Span(self.before, self.after)


class LossCounter:
    """Collects the gaps of one file."""

    def __init__(self, summary: McapSummary | None) -> None:
        """Take the file's own summary; None if it is lost."""
        self._summary = summary
        self._missing: list[_Missing] = []
        self._saved: set[int] = set()
        self._last: int | None = None
        self._is_open = False

    @property
    def last(self) -> int | None:
        """Latest log time [ns] of what was saved."""
        return self._last

    def saved_chunk(self, offset: int, start: int, end: int) -> None:
        """Count an intact chunk with its first and last log time [ns]."""
        self._saved.add(offset)
        self._saved_between(start, end)

    def saved_message(self, time: int) -> None:
        """Count an intact message outside of chunks, with its log time [ns]."""
        self._saved_between(time, time)

    def _saved_between(self, start: int, end: int) -> None:
        self._is_open = False
        for missing in reversed(self._missing):
            if missing.after is not None:
                break
            missing.after = start
        self._last = max(end, self._last or end)

    def gap(self, gap: Gap, head: Span = UNKNOWN) -> None:
        """Count a place that cannot be read; ``head``: log times that a chunk there claims.

        Raises:
            DiffbotError: if there are more than MAX_GAPS.
        """
        if len(self._missing) >= MAX_GAPS:
            raise DiffbotError(f"is damaged in more than {MAX_GAPS} places")
        self._missing.append(_Missing(gap, head, self._last))
        self._is_open = gap.opcode == Opcode.CHUNK

    def message_index(self, piece: Piece) -> None:
        """Count what a message index says of the damaged chunk before it."""
        if self._is_open:
            channel, entries = index_entries(piece.content)
            times = np.frombuffer(entries, "<u8")[::2]
            self._missing[-1].counts[channel] += len(times)
            self._missing[-1].times += [int(times.min()), int(times.max())] if len(times) else []

    def loss(self, saved: Mapping[int, int], topic: Callable[[int], str], *, is_cut: bool, unverified: int) -> Loss:
        """Return what is missing.

        Args:
            saved: messages saved, by channel.
            topic: name of a channel.
            is_cut: the file was not finished.
            unverified: messages saved from an incomplete chunk.
        """
        gaps = [missing for missing in self._missing if missing.gap.opcode != Opcode.MESSAGE_INDEX]
        lost: Counter[int] = Counter()
        if self._summary is not None:
            indexes = [one for one in self._summary.chunks if one.chunk_start_offset not in self._saved]
            chunks = len(indexes)
            spans = [Span(one.message_start_time, one.message_end_time) for one in indexes]
            for channel, count in self._summary.statistics.channel_message_counts.items():
                lost[channel] = max(0, count - saved.get(channel, 0))
        else:
            chunks = sum(missing.gap.opcode == Opcode.CHUNK and not missing.gap.is_cut for missing in gaps)
            spans = [missing.span() for missing in gaps]
            for missing in gaps:
                lost += missing.counts
        by_topic: Counter[str] = Counter()
        for channel, count in lost.items():
            by_topic[topic(channel)] += count
        return Loss(
            chunks=chunks,
            bytes=sum(missing.gap.end - missing.gap.offset for missing in self._missing),
            messages=+by_topic,
            is_exact=self._summary is not None,
            spans=tuple(spans),
            is_cut=is_cut,
            unverified=unverified,
        )
