"""The message records of one chunk of an MCAP file, made all at once.

The mcap library makes an object and several small writes of each message, 5 us together. Here the caller only collects
tuples, and one loop packs them, on whichever thread writes to the disk.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from mcap.opcode import Opcode

from diffbot_bag.mcap.format import CHUNK, MESSAGE, MESSAGE_INDEX, MESSAGE_RECORD, SIZE
from diffbot_bag.mcap.whole_chunk import KINDS

OVERHEAD = MESSAGE_RECORD.size
"""[bytes] of a message's record besides its data"""
CHUNK_OVERHEAD, CHANNEL_OVERHEAD = CHUNK.size + max(map(len, KINDS)) + SIZE.size, MESSAGE_INDEX.size
"""[bytes] of a chunk, and of the index of each of its channels, besides their contents"""
_MASK = 0xFFFFFFFF

Row = tuple[int, bytes, int, int, int]
"""Channel, data (CDR), log time [ns], publish time [ns], sequence number."""


def records(rows: Sequence[Row]) -> tuple[bytes, dict[int, list[int]]]:
    """Return the records of messages in their order, and the entries that ChunkPacker.pack takes with them."""
    entries: defaultdict[int, list[int]] = defaultdict(list)
    parts: list[bytes] = []
    head, opcode, fields, offset = MESSAGE_RECORD.pack, int(Opcode.MESSAGE), MESSAGE.size, 0
    for channel, data, log_time, publish_time, sequence in rows:
        entries[channel] += (log_time, offset)
        parts.append(head(opcode, fields + len(data), channel, sequence & _MASK, log_time, publish_time))
        parts.append(data)
        offset += OVERHEAD + len(data)
    return b"".join(parts), dict(entries)
