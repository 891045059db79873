"""Chunks of an MCAP file of unknown origin: how much they may unpack to, and unpacking them within that bound."""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator, Sequence
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped, unused-ignore]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex

from diffbot_bag.mcap.format import MESSAGE, RECORD, check_time
from diffbot_core.errors import DiffbotError

Row = tuple[int, int, int, int, bytes]
"""A message without an object: log time [ns], channel, sequence number, publish time [ns] and data."""
SMALL = 64 * 2**20
"""[bytes] what a bag may always unpack to, whatever its ratio"""


MIN_RECORD = 2
"""[bytes] of the file per record of a chunk, on average: identical messages take 5, with a message index 21"""
FEW_RECORDS = 64
"""that a chunk may always have"""
MAX_RECORDS = 2_000_000
"""of a chunk, and of chunks that overlap in time: each takes 200 bytes of memory"""
MEMORY_RATIO = 64
"""Unpacked size of chunks that overlap in time to the size of the file, beyond SMALL"""


class BagLimits(NamedTuple):
    """How much the chunks of one file may unpack to."""

    max_compression_ratio: float = 1000.0
    """Unpacked size of all chunks to their size in the file; recorded drives have 2 to 30."""
    max_unpacked_size: int = 512 * 2**20
    """[bytes] of chunks that overlap in time: their messages are held in memory together."""

    def memory(self, file_size: int) -> int:
        """Return how many [bytes] may be unpacked together of a file of this size [bytes]."""
        return min(self.max_unpacked_size, max(SMALL, MEMORY_RATIO * file_size))

    def unpacked(self, packed: int) -> int:
        """Return how many [bytes] so many [bytes] of a file may unpack to altogether."""
        return round(max(SMALL, self.max_compression_ratio * packed))


def check_chunks(chunks: Sequence[ChunkIndex], file_size: int, limits: BagLimits) -> None:
    """Check the index of all chunks.

    Raises:
        McapError: if chunks share bytes of the file or lie outside of it.
        DiffbotError: if they unpack to more than the limits allow.
    """
    end = 0
    for chunk in sorted(chunks, key=lambda chunk: chunk.chunk_start_offset):
        if chunk.chunk_start_offset < end or chunk.message_start_time > chunk.message_end_time:
            raise McapError("chunks that overlap")
        end = chunk.chunk_start_offset + chunk.chunk_length
    if end > file_size:
        raise McapError("a chunk beyond the file")
    check_time(max((chunk.message_end_time for chunk in chunks), default=0))
    total, packed = sum(chunk.uncompressed_size for chunk in chunks), sum(chunk.chunk_length for chunk in chunks)
    if total > limits.unpacked(packed):
        raise DiffbotError(
            f"its {packed} bytes of chunks unpack to {total}: must be <= max_compression_ratio"
            f" = {limits.max_compression_ratio:g} times as many"
        )
    most = limits.memory(file_size)
    if (held := _held_together(chunks)) > most:
        raise DiffbotError(
            f"chunks that overlap in time unpack to {held} bytes: must be <= {most}, the least of max_unpacked_size"
            f" = {limits.max_unpacked_size} and of {MEMORY_RATIO} times the file, or {SMALL}"
        )


def _held_together(chunks: Sequence[ChunkIndex]) -> int:
    """Return the largest sum of unpacked sizes [bytes] of chunks that share a time."""
    changes = [(chunk.message_start_time, 0, chunk.uncompressed_size) for chunk in chunks]
    changes += [(chunk.message_end_time, 1, -chunk.uncompressed_size) for chunk in chunks]
    held = most = 0
    for _, _, change in sorted(changes):
        held += change
        most = max(most, held)
    return most


def read_chunk(stream: BinaryIO, index: ChunkIndex) -> list[Row]:
    """Return the messages of one chunk in the order of the file.

    Raises:
        McapError, ValueError, struct.error, ...: DAMAGE of the module ``mcap_format``, if its index is wrong.
    """
    data = verified_chunk(stream, index).data
    rows: list[Row] = []
    for opcode, at, end in records_in(data, index.chunk_length):
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_time, publish_time = MESSAGE.unpack_from(data, at)
            rows.append((log_time, channel, sequence, publish_time, data[at + MESSAGE.size : end]))
    if rows and not index.message_start_time <= min(rows)[0] <= max(rows)[0] <= index.message_end_time:
        raise McapError("a message outside of its chunk's times")
    return rows


def records_in(data: bytes, packed: int, *, is_cut: bool = False) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of the content of each record in the unpacked data of a chunk.

    Args:
        data: of the chunk.
        packed: [bytes] that it takes in the file.
        is_cut: the data may end within a record, which is then left out.

    Raises:
        McapError, struct.error: if the data are not a sequence of records, or of too many.
    """
    at, size, left = 0, len(data), max_records(packed)
    while at < size:
        if is_cut and size - at < RECORD.size:
            return
        opcode, length = RECORD.unpack_from(data, at)
        begin = at + RECORD.size
        at = begin + length
        if at > size and is_cut:
            return
        # No record has the opcode 0: without this, zeros would be records of nine bytes.
        if at > size or opcode == 0 or (opcode == Opcode.MESSAGE and length < MESSAGE.size):
            raise McapError("no record, or one that is cut off, in a chunk")
        left -= 1
        if left < 0:
            raise McapError(f"more than {max_records(packed)} records in a chunk of {packed} bytes")
        yield opcode, begin, at


def max_records(packed: int) -> int:
    """Return how many records a chunk may have that takes ``packed`` [bytes] in the file."""
    return min(FEW_RECORDS + packed // MIN_RECORD, MAX_RECORDS)


class ChunkIndexes(NamedTuple):
    """What is in the data of a chunk."""

    entries: dict[int, list[int]]
    """By channel: log time [ns] and offset of a message, and so on in turn."""
    definitions: list[tuple[int, bytes]]
    """Opcode and content of each record that describes a schema or a channel."""


def index_messages(data: bytes, packed: int, *, is_cut: bool = False) -> ChunkIndexes:
    """Find the messages and definitions in the unpacked data of a chunk; arguments as for :func:`records_in`.

    Raises:
        McapError, struct.error: as for :func:`records_in`.
    """
    entries: dict[int, list[int]] = {}
    definitions = []
    for opcode, at, end in records_in(data, packed, is_cut=is_cut):
        if opcode == Opcode.MESSAGE:
            channel, _, log_time, _ = MESSAGE.unpack_from(data, at)
            found = entries.get(channel)
            if found is None:
                entries[channel] = [log_time, at - RECORD.size]
            else:
                found += (log_time, at - RECORD.size)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.append((opcode, data[at:end]))
    return ChunkIndexes(entries, definitions)


def verified_chunk(stream: BinaryIO, index: ChunkIndex) -> Chunk:
    """Return a chunk with its data unpacked and their checksum verified."""
    stream.seek(index.chunk_start_offset)
    record = stream.read(index.chunk_length)
    if record[:1] != bytes((Opcode.CHUNK,)):
        raise McapError("no chunk where the index has one")
    chunk: Chunk = Chunk.read(ReadDataStream(io.BytesIO(record[RECORD.size :])))
    chunk.compression, chunk.data = "", unpack_chunk(chunk, index.uncompressed_size)
    return chunk


def unpack_chunk(chunk: Chunk, size: int) -> bytes:
    """Return the contents of a chunk, whose size the index gives; what would be longer is not unpacked.

    Raises:
        McapError, ValueError, RuntimeError, ...: DAMAGE, if the chunk has another size or checksum.
    """
    data = _unpacked(chunk, size)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise McapError("checksum of a chunk")
    return data


def _unpacked(chunk: Chunk, size: int) -> bytes:
    if chunk.compression == "":
        data = chunk.data
    elif chunk.compression == "zstd":
        # Declared in the frame, this size is allocated whatever the limit.
        declared = zstandard.frame_content_size(chunk.data)
        if declared not in (-1, size):
            raise McapError("size of a chunk")
        data = zstandard.decompress(chunk.data, max_output_size=size)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    else:
        raise McapError("unknown compression of a chunk")
    if len(data) != size:
        raise McapError("size of a chunk")
    return data
