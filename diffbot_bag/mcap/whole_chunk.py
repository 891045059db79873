"""A chunk of an MCAP file with its message index, as bytes: packed of messages, or read as it stands."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped, unused-ignore]
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex

from diffbot_bag.mcap.format import CHUNK, ENTRY_SIZE, MESSAGE_INDEX, RECORD, SIZE

KINDS = ("zstd", "lz4", "none")
"""Compressions of MCAP."""
Entries = Mapping[int, Sequence[int]]
"""By channel: log time [ns] and offset in the unpacked data of each message, in turn."""


class Compression(NamedTuple):
    """How chunks are compressed."""

    kind: str = "zstd"
    """One of KINDS."""
    level: int = 0
    """Larger is smaller and slower; 0: the library's default."""


DEFAULT_COMPRESSION = Compression()


class WholeChunk(NamedTuple):
    """A chunk as it stands in a file."""

    place: ChunkIndex
    record: tuple[bytes, ...]
    """in parts, since joining them would copy the data"""
    message_index: bytes
    """of each of its channels, directly behind the chunk"""
    counts: dict[int, int]
    """Messages of each channel."""

    @property
    def size(self) -> int:
        """[bytes] with the message index."""
        return self.place.chunk_length + self.place.message_index_length


class ChunkPacker:
    """Packs chunks with one compression; for one thread at a time."""

    def __init__(self, compression: Compression = DEFAULT_COMPRESSION) -> None:
        """Prepare the compression, whose memory all chunks share."""
        self._name = "" if compression.kind == "none" else compression.kind
        self._compress = _compressor(compression)

    def pack(self, data: bytes, entries: Entries) -> WholeChunk:
        """Return the chunk of one message or more, as if it stood at the beginning of a file.

        Args:
            data: message records.
            entries: of these messages.
        """
        start = min(min(flat[::2]) for flat in entries.values())
        end = max(max(flat[::2]) for flat in entries.values())
        return frame_chunk(Chunk(self._name, self._compress(data), end, start, zlib.crc32(data), len(data)), entries)


def _compressor(compression: Compression) -> Callable[[bytes], bytes]:
    kind, level = compression
    if kind == "zstd":
        return zstandard.ZstdCompressor(level=level or 3).compress
    if kind == "lz4":
        return lambda data: bytes(lz4.frame.compress(data, compression_level=level))
    return lambda data: data


def frame_chunk(chunk: Chunk, entries: Entries) -> WholeChunk:
    """Return a chunk whose data are packed already, as if it stood at the beginning of a file.

    The mcap library writes a chunk in several steps and its index entry by entry, which takes ten times as long.

    Args:
        chunk: the record.
        entries: of its messages.
    """
    start, end, name = chunk.message_start_time, chunk.message_end_time, chunk.compression.encode()
    length = CHUNK.size - RECORD.size + len(name) + SIZE.size + len(chunk.data)
    head = CHUNK.pack(Opcode.CHUNK, length, start, end, chunk.uncompressed_size, chunk.uncompressed_crc, len(name))
    offsets, indexes, begin = {}, [], RECORD.size + length
    at = begin
    for channel, flat in entries.items():
        offsets[channel] = at
        size = len(flat) // 2 * ENTRY_SIZE
        indexes.append(MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, MESSAGE_INDEX.size - RECORD.size + size, channel, size))
        indexes.append(struct.pack(f"<{len(flat)}Q", *flat))
        at += MESSAGE_INDEX.size + size
    place = ChunkIndex(
        chunk_start_offset=0,
        chunk_length=begin,
        message_start_time=start,
        message_end_time=end,
        message_index_offsets=offsets,
        message_index_length=at - begin,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        uncompressed_size=chunk.uncompressed_size,
    )
    counts = {channel: len(flat) // 2 for channel, flat in entries.items()}
    record = head + name + SIZE.pack(len(chunk.data)), chunk.data
    return WholeChunk(place, record, b"".join(indexes), counts)


def chunk_end(index: ChunkIndex) -> int:
    """Return the offset of what follows a chunk."""
    return index.chunk_start_offset + index.chunk_length


def check_chunk(index: ChunkIndex, record: bytes, message_index: bytes) -> WholeChunk:
    """Return a chunk that was read from a file; its contents are not unpacked.

    Raises:
        McapError, struct.error: if the bytes are not what the index says.
    """
    opcode, length, start, end, unpacked, _, _ = CHUNK.unpack_from(record)
    if opcode != Opcode.CHUNK or length + RECORD.size != index.chunk_length:
        raise McapError("no chunk where the index has one")
    if (start, end, unpacked) != (index.message_start_time, index.message_end_time, index.uncompressed_size):
        raise McapError("a chunk that differs from its index")
    counts: dict[int, int] = {}
    at, begin = 0, chunk_end(index)
    while at < index.message_index_length:
        opcode, length, channel, size = MESSAGE_INDEX.unpack_from(message_index, at)
        expected = index.message_index_offsets.get(channel)
        if opcode != Opcode.MESSAGE_INDEX or expected != begin + at or size % ENTRY_SIZE:
            raise McapError("a message index that differs from the index of its chunk")
        counts[channel] = size // ENTRY_SIZE
        at += RECORD.size + length
    return WholeChunk(index, (record,), message_index, counts)
