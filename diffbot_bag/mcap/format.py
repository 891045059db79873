"""Constants of the MCAP format, its summary, and the exceptions of corrupt data."""

from __future__ import annotations

import io
import struct
import zlib
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, ChunkIndex, MetadataIndex, Schema, Statistics
from mcap.stream_reader import StreamReader

from diffbot_core.errors import DiffbotError

MAGIC = b"\x89MCAP0\r\n"
CRC = struct.Struct("<I")
RECORD = struct.Struct("<BQ")
"""opcode and length of a record"""
SIZE = struct.Struct("<Q")
"""[bytes] of the data of a chunk or an attachment, which follow"""
MESSAGE = struct.Struct("<HIQQ")
"""content of a message: channel, sequence number, log time and publish time; the data follow"""
MESSAGE_RECORD = struct.Struct("<BQHIQQ")
"""RECORD and MESSAGE"""
CHUNK = struct.Struct("<BQQQQII")
"""opcode, length, first and last log time, unpacked size, checksum and length of the compression's name, which follows;
then SIZE and the packed data"""
MESSAGE_INDEX = struct.Struct("<BQHI")
"""opcode, length, channel and [bytes] of the entries, which follow"""
_INDEX_HEAD = struct.Struct("<HI")
"""MESSAGE_INDEX without opcode and length"""
ENTRY_SIZE = 16
"""[bytes] log time and offset of a message in the index of its chunk"""
ATTACHMENT = struct.Struct("<QQIIQI")
"""what of an attachment has a fixed length: two times, lengths of two texts, size of the data, checksum"""
FOOTER = struct.Struct("<BQQQI")
"""opcode, length, offsets of the summary and of its index, checksum; MAGIC follows and ends the file"""
MAX_INDEX = 64 * 2**20
"""[bytes] of the summary: that of 100 GB in chunks of 768 kB has 30 MB"""
MAX_TIME = 2**62
"""[ns] of a log time, the year 2116; differences to any stamp fit into 64 bits"""
DAMAGE = (
    McapError,
    struct.error,
    zstandard.ZstdError,
    ValueError,
    KeyError,
    IndexError,
    MemoryError,
    OverflowError,
    RuntimeError,  # of lz4; and RecursionError, of message definitions that contain themselves
    TypeError,
    AttributeError,
)
"""Exceptions with which the mcap library reacts to corrupt data."""


def check_time(log_time: int) -> None:
    """Refuse a log time [ns] beyond MAX_TIME.

    Raises:
        DiffbotError: if it is.
    """
    if log_time > MAX_TIME:
        raise DiffbotError(f"log time {log_time} ns: must be <= {MAX_TIME}")


def index_entries(content: bytes) -> tuple[int, bytes]:
    """Return the channel of a message index and its entries, ENTRY_SIZE [bytes] each.

    Args:
        content: of the record, without opcode and length.

    Raises:
        McapError, struct.error: if it is not as long as it says.
    """
    channel, size = _INDEX_HEAD.unpack_from(content)
    entries = content[_INDEX_HEAD.size :]
    if len(entries) != size or size % ENTRY_SIZE:
        raise McapError("a message index of another length")
    return channel, entries


class NoIndexError(DiffbotError):
    """The file was finished without an index."""


class McapSummary(NamedTuple):
    """What a file says of itself at its end."""

    start: int
    """Offset in the file."""
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    chunks: list[ChunkIndex]
    statistics: Statistics
    attached: list[AttachmentIndex | MetadataIndex]
    """In the order of the file."""


def read_summary(stream: BinaryIO, size: int) -> McapSummary:
    """Read and verify the summary of a file of ``size`` bytes.

    Raises:
        NoIndexError: if there is none.
        DiffbotError: if it is larger than MAX_INDEX.
        McapError, ValueError, struct.error, ...: DAMAGE, if it is not what the format says.
    """
    start, content = _verified_summary(stream, size)
    schemas, channels, chunks, attached, statistics = {}, {}, [], [], None
    # Chunks have no place in a summary: they are not unpacked here.
    for record in StreamReader(io.BytesIO(content), skip_magic=True, emit_chunks=True).records:
        if isinstance(record, Statistics):
            statistics = record
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, ChunkIndex):
            chunks.append(record)
        elif isinstance(record, (AttachmentIndex, MetadataIndex)):
            attached.append(record)
    if statistics is None:
        raise NoIndexError("has no index")
    return McapSummary(start, schemas, channels, chunks, statistics, attached)


def _verified_summary(stream: BinaryIO, size: int) -> tuple[int, bytes]:
    """Return where the summary begins, and its bytes and all that follows them."""
    end = size - len(MAGIC) - FOOTER.size
    stream.seek(max(end, 0))
    opcode, length, start, _, checksum = FOOTER.unpack(stream.read(FOOTER.size))
    if opcode != Opcode.FOOTER or length != FOOTER.size - RECORD.size or stream.read() != MAGIC:
        raise McapError("no footer")
    if start == 0:
        raise NoIndexError("has no index")
    if not len(MAGIC) <= start <= end:
        raise McapError("an index beyond the file")
    if end - start > MAX_INDEX:
        raise DiffbotError(f"its index has {end - start} bytes: must be <= {MAX_INDEX}")
    stream.seek(start)
    content = stream.read()
    if checksum and checksum != zlib.crc32(content[: -len(MAGIC) - CRC.size]):
        raise McapError("checksum of the index")
    return start, content
