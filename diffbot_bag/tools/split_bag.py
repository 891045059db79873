"""Write a bag of several files, each of which can be used without the others."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

from diffbot_bag.bag.reader import MAX_FILES
from diffbot_bag.mcap.whole_chunk import WholeChunk
from diffbot_bag.tools.channels import Channels
from diffbot_bag.tools.latched import LatchedHistory, at_time, delivered, latches_of
from diffbot_bag.tools.output_bag import Description, OutputBag
from diffbot_bag.tools.output_file import ENVELOPE
from diffbot_bag.tools.source_bag import Row
from diffbot_bag.tools.time_order import Piece
from diffbot_core.errors import DiffbotError


class FileLimits(NamedTuple):
    """When the next file of a bag begins; 0: no such limit."""

    size: int = 0
    """[bytes] of a file, which is larger only if one message is"""
    duration: int = 0
    """[ns] of log time"""
    messages: int = 0
    """Number of messages, without those that are repeated at the head of a file."""


class SplitBag(OutputBag):
    """A bag of several files; each begins with the last messages of latched topics in the files before it."""

    def __init__(self, folder: Path, channels: Channels, description: Description, limits: FileLimits) -> None:
        """Create the folder and its first file.

        Raises:
            OSError: if they cannot be written.
        """
        super().__init__(folder, channels, description)
        self._limits = limits
        self._latches = latches_of(channels.qos)
        self._history = LatchedHistory(self._latches)
        self._start: int | None = None
        self._count = 0

    def takes(self, chunk: WholeChunk) -> bool:
        """Return whether the next chunk can be copied whole; the next file is begun if it fits only there."""
        limits, count = self._limits, sum(chunk.counts.values())
        if not count:
            return False
        start = self._begin(chunk.place.message_start_time)
        if limits.duration and chunk.place.message_end_time >= start + limits.duration:
            return False
        if limits.messages and self._count + count > limits.messages:
            return False
        if limits.size and chunk.size > self._space() and self._count:
            self._next_file(chunk.place.message_start_time)
        return not limits.size or chunk.size <= self._space()

    def copy(self, piece: Piece, chunk: WholeChunk) -> None:
        """Append a chunk that the bag takes.

        Raises:
            OSError: if the disk is full.
        """
        super().copy(piece, chunk)
        self._history.add_piece(piece)
        self._count += sum(chunk.counts.values())

    def write(self, rows: Sequence[Row]) -> None:
        """Append messages, into as many files as it takes.

        Raises:
            OSError: if the disk is full.
            DiffbotError: if there are too many files.
        """
        at = 0
        while at < len(rows):
            end = self._fitting(rows, at, self._begin(rows[at][0]))
            if end == at:
                self._next_file(rows[at][0])
                continue
            super().write(rows[at:end])
            self._history.add_rows(rows[at:end])
            self._count += end - at
            at = end

    def _begin(self, time: int) -> int:
        """Begin the next file if a message of this time [ns] belongs there; return when the file begins."""
        limits = self._limits
        if self._start is None:
            self._start = time
        elif limits.duration and time >= self._start + limits.duration:
            self._next_file(time - (time - self._start) % limits.duration)
        elif limits.messages and self._count >= limits.messages:
            self._next_file(time)
        return self._start

    def _fitting(self, rows: Sequence[Row], at: int, start: int) -> int:
        """Return the end of the rows from ``at`` on that the file has room for; a new file has it for one at least."""
        limits, end = self._limits, len(rows)
        if limits.messages:
            end = min(end, at + limits.messages - self._count)
        if limits.duration:
            end = bisect_left(rows, start + limits.duration, at, end, key=itemgetter(0))
        if not limits.size:
            return end
        space = self._space()
        for number in range(at, end):
            space -= len(rows[number][2]) + ENVELOPE
            if space < 0:
                return number if number > at or self._count else at + 1
        return end

    def _space(self) -> int:
        """Return the bytes that are left in the file."""
        return self._limits.size - self._file.final_size - self._reserve

    def _next_file(self, time: int) -> None:
        rows = delivered(self._history.rows(), time, self._latches)
        self._end_file()
        if len(self._written) >= MAX_FILES:
            raise DiffbotError(f"more than {MAX_FILES} files: the size, duration or count of each must be larger")
        self._file = self._open()
        super().write(at_time(rows, time))
        self._start, self._count = time, 0
