"""The messages of one chunk of an MCAP file, packed all at once.

The mcap library makes an object and several small writes of each message, 5 us together. Here the caller only collects
tuples, and one loop packs them, on whichever thread writes to the disk.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

from mcap.opcode import Opcode

_HEAD = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time and publish time; the data follow."""
_FIELDS = 22
"""[bytes] of a message's record between its length and its data"""
OVERHEAD = _HEAD.size
"""[bytes] of a message's record besides its data"""
INDEX_ENTRY = 16
"""[bytes] of a message in the index of its chunk"""
CHUNK_OVERHEAD, CHANNEL_OVERHEAD = 57, 15
"""[bytes] of a chunk, and of the index of each of its channels, besides their contents"""
_MASK = 0xFFFFFFFF

Row = tuple[int, bytes, int, int, int]
"""Channel, data (CDR), log time [ns], publish time [ns], sequence number."""


class Chunk(NamedTuple):
    """Packed messages; times in [ns]."""

    data: bytes
    """Message records, as they stand in the file before compression."""
    entries: dict[int, list[int]]
    """By channel: log time and offset in ``data`` of each message, alternately."""
    start: int
    end: int

    @property
    def counts(self) -> dict[int, int]:
        """Number of messages, by channel."""
        return {channel: len(entries) // 2 for channel, entries in self.entries.items()}


def pack(rows: Sequence[Row]) -> Chunk:
    """Return the chunk of one message or more, in their order."""
    entries: defaultdict[int, list[int]] = defaultdict(list)
    parts: list[bytes] = []
    head, opcode, offset = _HEAD.pack, int(Opcode.MESSAGE), 0
    for channel, data, log_time, publish_time, sequence in rows:
        entries[channel] += (log_time, offset)
        parts.append(head(opcode, _FIELDS + len(data), channel, sequence & _MASK, log_time, publish_time))
        parts.append(data)
        offset += OVERHEAD + len(data)
    times = [row[2] for row in rows]
    return Chunk(b"".join(parts), dict(entries), min(times), max(times))
