"""A chunk of an MCAP file with its index, as bytes: read as it stands, or packed of messages."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped, unused-ignore]
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import ChunkIndex

RECORD = struct.Struct("<BQ")
"""Opcode and length of a record."""
ENTRY_SIZE = 16
"""[bytes] log time and offset of a message in the index of its chunk"""
_CHUNK = struct.Struct("<BQQQQI")
"""Opcode and length of a chunk, its first and last log time, its unpacked size and checksum."""
_TEXT_LENGTH = struct.Struct("<I")
_DATA_LENGTH = struct.Struct("<Q")
_INDEX = struct.Struct("<BQHI")
"""Opcode and length of a message index, its channel, the size of its entries [bytes]."""
PACK: dict[str, Callable[[bytes], bytes]] = {
    "zstd": zstandard.ZstdCompressor().compress,
    "lz4": lz4.frame.compress,
    "": bytes,
}
"""Compressions of MCAP by name; empty: none."""


class WholeChunk(NamedTuple):
    """A chunk as it stands in a file."""

    place: ChunkIndex
    record: bytes
    message_index: bytes
    """of each of its channels, directly behind the chunk"""
    counts: dict[int, int]
    """Messages of each channel."""


def chunk_end(index: ChunkIndex) -> int:
    """Return the offset of what follows a chunk."""
    return index.chunk_start_offset + index.chunk_length


def check_chunk(index: ChunkIndex, record: bytes, message_index: bytes) -> WholeChunk:
    """Return a chunk that was read from a file; its contents are not unpacked.

    Raises:
        McapError, struct.error: if the bytes are not what the index says.
    """
    opcode, length, start, end, unpacked, _ = _CHUNK.unpack_from(record)
    if opcode != Opcode.CHUNK or length + RECORD.size != index.chunk_length:
        raise McapError("no chunk where the index has one")
    if (start, end, unpacked) != (index.message_start_time, index.message_end_time, index.uncompressed_size):
        raise McapError("a chunk that differs from its index")
    counts: dict[int, int] = {}
    at, begin = 0, chunk_end(index)
    while at < index.message_index_length:
        opcode, length, channel, size = _INDEX.unpack_from(message_index, at)
        expected = index.message_index_offsets.get(channel)
        if opcode != Opcode.MESSAGE_INDEX or expected != begin + at or size % ENTRY_SIZE:
            raise McapError("a message index that differs from the index of its chunk")
        counts[channel] = size // ENTRY_SIZE
        at += RECORD.size + length
    return WholeChunk(index, record, message_index, counts)


def pack_chunk(parts: Sequence[bytes], entries: Mapping[int, Sequence[int]], compression: str) -> WholeChunk:
    """Return a chunk of these records, as if it stood at the beginning of a file.

    Args:
        parts: the records; at least one message.
        entries: of each channel: log time [ns] and offset of its messages, in turns.
        compression: a key of PACK.
    """
    data = b"".join(parts)
    packed = PACK[compression](data)
    start = min(min(flat[::2]) for flat in entries.values())
    end = max(max(flat[::2]) for flat in entries.values())
    name = compression.encode()
    rest = b"".join((_TEXT_LENGTH.pack(len(name)), name, _DATA_LENGTH.pack(len(packed)), packed))
    length = _CHUNK.size - RECORD.size + len(rest)
    record = _CHUNK.pack(Opcode.CHUNK, length, start, end, len(data), zlib.crc32(data)) + rest
    offsets, indexes, at = {}, [], len(record)
    for channel, flat in entries.items():
        offsets[channel] = at
        size = len(flat) // 2 * ENTRY_SIZE
        indexes.append(_INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX.size - RECORD.size + size, channel, size))
        indexes.append(struct.pack(f"<{len(flat)}Q", *flat))
        at += _INDEX.size + size
    message_index = b"".join(indexes)
    index = ChunkIndex(
        chunk_start_offset=0,
        chunk_length=len(record),
        message_start_time=start,
        message_end_time=end,
        message_index_offsets=offsets,
        message_index_length=len(message_index),
        compression=compression,
        compressed_size=len(packed),
        uncompressed_size=len(data),
    )
    return WholeChunk(index, record, message_index, {channel: len(flat) // 2 for channel, flat in entries.items()})
