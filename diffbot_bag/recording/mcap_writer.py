"""Write one MCAP file from packed chunks; records by the mcap library, chunks compressed at a level of choice.

The writer of the mcap library has no compression level, and compresses and writes a chunk within the call that happens
to fill it. Here that is a call of its own, which another thread may make while messages are received.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame  # type: ignore[import-untyped, unused-ignore]
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from diffbot_bag.recording.chunk import Chunk

_CHUNK = struct.Struct("<BQQQQII")
"""Opcode, length, start, end, unpacked size, checksum, length of the compression's name; name, size and data follow."""
_INDEX = struct.Struct("<BQHI")
"""Opcode, length, channel and size of the entries of a message index."""
_FOOTER = struct.Struct("<BQQQ")
"""What of the footer the summary's checksum includes."""


class Compression(NamedTuple):
    """How chunks are compressed."""

    kind: str = "zstd"
    """``zstd``, ``lz4`` or ``none``."""
    level: int = 0
    """Larger is smaller and slower; 0: the library's default."""


DEFAULT_COMPRESSION = Compression()


def _compressor(compression: Compression) -> Callable[[bytes], bytes]:
    kind, level = compression
    if kind == "zstd":
        return zstandard.ZstdCompressor(level=level or 3).compress
    if kind == "lz4":
        return lambda data: bytes(lz4.frame.compress(data, compression_level=level))
    return lambda data: data


class McapWriter:
    """One MCAP file; each method raises OSError if the disk does."""

    def __init__(self, path: Path, compression: Compression) -> None:
        """Create the file, which must not exist, and write its header."""
        self.path = path
        self.size = 0
        """[bytes] written so far"""
        self.statistics = Statistics(0, 0, {}, 0, 0, 0, 0, 0, 0)
        self._compress = _compressor(compression)
        self._name = b"" if compression.kind == "none" else compression.kind.encode()
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._stream = path.open("xb")
        self._write(MCAP0_MAGIC)
        self._record(Header("ros2", "diffbot"))

    @property
    def fileno(self) -> int:
        """Descriptor of the open file."""
        return self._stream.fileno()

    def add_schema(self, schema: Schema) -> None:
        """Write a schema; outside of the chunks, so that a damaged chunk does not take it along."""
        self._schemas[schema.id] = schema
        self._record(schema)

    def add_channel(self, channel: Channel) -> None:
        """Write a channel, whose schema was written before."""
        self._channels[channel.id] = channel
        self._record(channel)

    def add_chunk(self, chunk: Chunk) -> None:
        """Compress a chunk and write it with its index."""
        packed, name, offset = self._compress(chunk.data), self._name, self.size
        self._write(
            _CHUNK.pack(
                Opcode.CHUNK, _CHUNK.size - 9 + len(name) + 8 + len(packed),
                chunk.start, chunk.end, len(chunk.data), zlib.crc32(chunk.data), len(name),
            ) + name + struct.pack("<Q", len(packed))
        )  # fmt: skip
        self._write(packed)
        length, offsets = self.size - offset, {}
        for channel, entries in chunk.entries.items():
            offsets[channel] = self.size
            size = 8 * len(entries)
            self._write(_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
            self._write(struct.pack(f"<{len(entries)}Q", *entries))
        self._chunks.append(
            ChunkIndex(
                chunk_length=length, chunk_start_offset=offset, compression=name.decode(), compressed_size=len(packed),
                message_end_time=chunk.end, message_index_length=self.size - offset - length,
                message_index_offsets=offsets, message_start_time=chunk.start, uncompressed_size=len(chunk.data),
            )
        )  # fmt: skip
        self._count(chunk)

    def _count(self, chunk: Chunk) -> None:
        total = self.statistics
        first = not total.message_count
        total.message_start_time = chunk.start if first else min(total.message_start_time, chunk.start)
        total.message_end_time = max(total.message_end_time, chunk.end)
        for channel, count in chunk.counts.items():
            total.message_count += count
            total.channel_message_counts[channel] = total.channel_message_counts.get(channel, 0) + count

    def add_attachment(self, time: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment that was made at ``time`` [ns]."""
        offset = self.size
        self._record(Attachment(time, time, name, media_type, data))
        self._attachments.append(AttachmentIndex(offset, self.size - offset, time, time, len(data), name, media_type))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        offset = self.size
        self._record(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset, self.size - offset, name))

    def flush(self, sync: bool) -> None:
        """Hand everything to the operating system, so that it outlives the process; ``sync``: to the disk, too."""
        self._stream.flush()
        if sync:
            os.fsync(self._stream.fileno())

    def finish(self) -> None:
        """Write the summary, bring the file to the disk and close it."""
        self._record(DataEnd(0))
        start = self.size
        self._complete_statistics()
        groups: tuple[tuple[Opcode, list[Any]], ...] = (
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [self.statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        )
        builder, offsets = RecordBuilder(), []
        for opcode, records in groups:
            before = builder.count
            for record in records:
                record.write(builder)
            if records:
                offsets.append(SummaryOffset(opcode, builder.count - before, start + before))
        offset_start = start + builder.count
        for offset in offsets:
            offset.write(builder)
        summary = builder.end()  # type: ignore[no-untyped-call]
        checksum = zlib.crc32(_FOOTER.pack(Opcode.FOOTER, 20, start, offset_start), zlib.crc32(summary))
        self._write(summary)
        self._record(Footer(start, offset_start, checksum))
        self._write(MCAP0_MAGIC)
        self.flush(sync=True)
        self._stream.close()

    def _complete_statistics(self) -> None:
        total = self.statistics
        total.schema_count, total.channel_count = len(self._schemas), len(self._channels)
        total.attachment_count, total.metadata_count = len(self._attachments), len(self._metadata)
        total.chunk_count = len(self._chunks)

    def abandon(self) -> None:
        """Close the file as it is, after an error."""
        # Closing flushes the rest of the buffer, which fails for the same reason.
        with contextlib.suppress(OSError):
            self._stream.close()

    def _record(self, record: Any) -> None:
        builder = RecordBuilder()
        record.write(builder)
        self._write(builder.end())  # type: ignore[no-untyped-call]

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self.size += len(data)
