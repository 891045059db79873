"""Write an MCAP file of chunks that are copied as they are packed, with an index of its own."""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter
from typing import Any, BinaryIO

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
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

from diffbot_bag.mcap_format import MAGIC, RECORD
from diffbot_bag.writer import CHUNK_SIZE

_MESSAGE_INDEX = struct.Struct("<BQHI")
"""Opcode, length, channel and bytes of the entries, which follow."""
_FOOTER_HEAD = struct.Struct("<BQQQ")


class IndexedCopy:
    """Writer of one file. Schemas and channels keep their numbers."""

    def __init__(self, stream: BinaryIO, header: Header) -> None:
        """Begin the file in an empty stream.

        Raises:
            OSError: as all methods, if the disk is full.
        """
        self._stream = stream
        self.counts: Counter[int] = Counter()
        """Messages by channel."""
        self.start = self.end = 0
        """[ns] first and last log time; zeros without a message."""
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._in_data: set[int] = set()
        self._indexes: dict[int, list[bytes]] = {
            opcode: [] for opcode in (Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX)
        }
        self._loose, self._loose_entries = bytearray(), dict[int, list[int]]()
        stream.write(MAGIC)
        stream.write(_packed(header))

    @property
    def channels(self) -> dict[int, Channel]:
        """Channels by number."""
        return self._channels

    @property
    def schemas(self) -> dict[int, Schema]:
        """Schemas by number."""
        return self._schemas

    def define(self, schema: Schema | None, channel: Channel, *, in_chunk: bool = False) -> None:
        """Describe a channel, before its first message; ``in_chunk``: the next chunk contains both records."""
        if channel.id in self._in_data:
            return
        self._in_data.add(channel.id)
        self._channels[channel.id] = channel
        if schema is not None:
            self._schemas[schema.id] = schema
        if not in_chunk:
            self._stream.write((b"" if schema is None else _packed(schema)) + _packed(channel))

    def add_chunk(self, chunk: Chunk, entries: dict[int, list[int]]) -> None:
        """Append a packed chunk.

        Args:
            chunk: the record.
            entries: log time [ns] and offset in the unpacked data of each message, in turn, by channel.
        """
        self.flush()
        self._append(chunk, entries)

    def add_message(self, channel: int, log_time: int, content: bytes) -> None:
        """Append a message; such messages are packed into chunks of their own.

        Args:
            channel: its number.
            log_time: [ns].
            content: of the record, without opcode and length.
        """
        self._loose_entries.setdefault(channel, []).extend((log_time, len(self._loose)))
        self._loose += RECORD.pack(Opcode.MESSAGE, len(content)) + content
        if len(self._loose) >= CHUNK_SIZE:
            self.flush()

    def flush(self) -> None:
        """Write the chunk of single messages."""
        if not self._loose:
            return
        data, entries = bytes(self._loose), self._loose_entries
        self._loose, self._loose_entries = bytearray(), {}
        times = [time for found in entries.values() for time in found[::2]]
        packed = zstandard.compress(data)
        self._append(Chunk("zstd", packed, max(times), min(times), zlib.crc32(data), len(data)), entries)

    def _append(self, chunk: Chunk, entries: dict[int, list[int]]) -> None:
        offset, record = self._stream.tell(), _packed(chunk)
        self._stream.write(record)
        index_start, offsets, written = offset + len(record), {}, 0
        is_first = not self.counts
        for channel, found in entries.items():
            content = np.array(found, np.uint64).astype("<u8").tobytes()
            offsets[channel] = index_start + written
            written += self._stream.write(
                _MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(content), channel, len(content)) + content
            )
            self.counts[channel] += len(found) // 2
        if entries:
            start = chunk.message_start_time
            self.start = start if is_first else min(self.start, start)
            self.end = max(self.end, chunk.message_end_time)
        index = ChunkIndex(
            chunk_length=len(record),
            chunk_start_offset=offset,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=written,
            message_index_offsets=offsets,
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
        self._indexes[Opcode.CHUNK_INDEX].append(_packed(index))

    def add_attachment(self, source: BinaryIO, length: int, index: AttachmentIndex) -> None:
        """Append an attachment of ``length`` [bytes] from the place of ``source``; of its index, the offset is set."""
        self.flush()
        index.offset, index.length = self._stream.tell(), length
        while length > 0:
            block = source.read(min(length, 2**20))
            if not block:
                raise EOFError("an attachment has become shorter")
            length -= self._stream.write(block)
        self._indexes[Opcode.ATTACHMENT_INDEX].append(_packed(index))

    def add_metadata(self, metadata: Metadata) -> None:
        """Append a metadata record."""
        self.flush()
        offset, record = self._stream.tell(), _packed(metadata)
        self._stream.write(record)
        index = MetadataIndex(offset, len(record), metadata.name)
        self._indexes[Opcode.METADATA_INDEX].append(_packed(index))

    def finish(self) -> None:
        """Write the index and the end of the file."""
        self.flush()
        self._stream.write(_packed(DataEnd(0)))
        start, summary, offsets = self._stream.tell(), io.BytesIO(), []
        for opcode, records in (
            (Opcode.SCHEMA, [_packed(schema) for schema in self._schemas.values()]),
            (Opcode.CHANNEL, [_packed(channel) for channel in self._channels.values()]),
            (Opcode.STATISTICS, [_packed(self._statistics())]),
            *self._indexes.items(),
        ):
            group_start = start + summary.tell()
            if length := sum(map(summary.write, records)):
                offsets.append(_packed(SummaryOffset(opcode, group_start, length)))
        offset_start = start + summary.tell()
        summary.writelines(offsets)
        content = summary.getvalue()
        head = _FOOTER_HEAD.pack(Opcode.FOOTER, 20, start, offset_start)
        self._stream.write(content)
        self._stream.write(_packed(Footer(start, offset_start, zlib.crc32(head, zlib.crc32(content)))) + MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._indexes[Opcode.ATTACHMENT_INDEX]),
            channel_count=len(self._channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self._indexes[Opcode.CHUNK_INDEX]),
            message_count=self.counts.total(),
            message_end_time=self.end,
            message_start_time=self.start,
            metadata_count=len(self._indexes[Opcode.METADATA_INDEX]),
            schema_count=len(self._schemas),
        )


def _packed(record: Any) -> bytes:
    """Return the bytes of a record."""
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    return written
