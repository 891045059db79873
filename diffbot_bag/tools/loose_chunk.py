"""What can still be unpacked of a chunk that is damaged or incomplete."""

from __future__ import annotations

import io
import struct
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped, unused-ignore]
import zstandard

from diffbot_bag.mcap.chunks import BagLimits, ChunkIndexes, index_messages
from diffbot_bag.mcap.format import CHUNK, DAMAGE, SIZE

_STEP = 64 * 1024
"""[bytes] unpacked at once: what precedes the damage is kept"""


class LooseChunk(NamedTuple):
    """The beginning of a chunk, not verified."""

    start: int
    """[ns] first log time, as its head says."""
    end: int
    data: bytes
    indexes: ChunkIndexes


def read_loosely(stream: BinaryIO, size: int, offset: int, end: int, limits: BagLimits) -> LooseChunk | None:
    """Read the record of a chunk between two offsets of a file of ``size`` [bytes]; None without a complete head."""
    most = limits.memory(size)
    if end - offset > most:
        return None
    stream.seek(offset)
    record = stream.read(end - offset)
    try:
        _, _, start, last, unpacked, _, length = CHUNK.unpack_from(record)
    except struct.error:
        return None
    name = record[CHUNK.size : CHUNK.size + length] if length <= 4 else b"?"
    packed = record[CHUNK.size + len(name) + SIZE.size :]
    data = _unpacked(name, packed, min(unpacked, most))
    try:
        indexes = index_messages(data, end - offset, is_cut=True)
    except DAMAGE:
        indexes = ChunkIndexes({}, [])
    return LooseChunk(start, last, data, indexes)


def _unpacked(compression: bytes, packed: bytes, size: int) -> bytes:
    """Return at most ``size`` bytes, up to where the data end or are damaged."""
    if compression == b"":
        return packed[:size]
    if compression not in (b"zstd", b"lz4"):
        return b""
    source = io.BytesIO(packed)
    found = bytearray()
    try:
        stream = (
            zstandard.ZstdDecompressor().stream_reader(source) if compression == b"zstd" else lz4.frame.open(source)
        )
        while len(found) < size and (block := stream.read(min(_STEP, size - len(found)))):
            found += block
    except (*DAMAGE, EOFError, OSError):
        pass
    return bytes(found)
