"""Messages on their way into one chunk of an MCAP file.

The mcap library makes an object and several small writes of each message, 5 us together; at 8 kHz that is a quarter of
all that a recorder costs. Here a message is packed in one step, and its index is a flat list.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from typing import NamedTuple

from mcap.opcode import Opcode

_HEAD = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time and publish time; the data follow."""
_FIELDS = 22
"""[bytes] of a message's record between its length and its data"""
_INDEX_HEAD, _CHUNK_HEAD = 15, 53
"""[bytes] of the index of one channel, and of a chunk, besides their contents"""
_MASK = 0xFFFFFFFF
_MESSAGE = int(Opcode.MESSAGE)


class SealedChunk(NamedTuple):
    """A chunk that gets no more messages; times in [ns]."""

    data: bytes | bytearray
    """Message records, as they stand in the file before compression."""
    entries: dict[int, list[int]]
    """By channel: log time and offset in ``data`` of each message, alternately."""
    start: int
    end: int

    @property
    def size(self) -> int:
        """What the chunk and its index take in a file if nothing is compressed [bytes]."""
        return len(self.data) + sum(_INDEX_HEAD + 8 * len(entries) for entries in self.entries.values()) + _CHUNK_HEAD

    @property
    def counts(self) -> dict[int, int]:
        """Number of messages, by channel."""
        return {channel: len(entries) // 2 for channel, entries in self.entries.items()}


class ChunkBuilder:
    """Collects messages until they are sealed as a chunk."""

    __slots__ = ("_buffer", "_index")

    def __init__(self) -> None:
        """Start without messages."""
        self._buffer = bytearray()
        self._index: defaultdict[int, list[int]] = defaultdict(list)

    def __len__(self) -> int:
        """Return the size [bytes] of what was collected."""
        return len(self._buffer)

    def add(self, channel: int, data: bytes, log_time: int, publish_time: int, sequence: int) -> int:
        """Append a message, times in [ns]; return the size [bytes] of the chunk so far."""
        buffer = self._buffer
        self._index[channel] += (log_time, len(buffer))
        buffer += _HEAD.pack(_MESSAGE, _FIELDS + len(data), channel, sequence & _MASK, log_time, publish_time)
        buffer += data
        return len(buffer)

    def seal(self) -> SealedChunk | None:
        """Return what was collected and start anew; None if there is nothing."""
        if not self._buffer:
            return None
        index, data = dict(self._index), self._buffer
        self._buffer, self._index = bytearray(), defaultdict(list)
        start = min(min(entries[::2]) for entries in index.values())
        end = max(max(entries[::2]) for entries in index.values())
        return SealedChunk(data, index, start, end)
