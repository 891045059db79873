"""Write an MCAP file of whole chunks, with its index; records other than chunks are packed by the mcap library.

The writer of that library takes messages only, has no compression level, and compresses and writes a chunk within the
call that happens to fill it. Here, packing a chunk and writing it are calls of their own, on a thread of choice, and a
chunk of another file is copied as it is.
"""

from __future__ import annotations

import contextlib
import os
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    DataEnd,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from diffbot_bag.mcap.format import CRC, FOOTER, MAGIC, RECORD
from diffbot_bag.mcap.whole_chunk import WholeChunk

OWN_HEADER = Header("ros2", "diffbot")


class McapOutput:
    """One MCAP file that is being written. Each method raises OSError if the disk does."""

    def __init__(self, stream: BinaryIO, header: Header = OWN_HEADER) -> None:
        """Begin the file in an empty stream, which :meth:`finish` and :meth:`abandon` close."""
        self._stream = stream
        self.size = 0
        """[bytes] written so far"""
        self.index_size = 0
        """[bytes] that the index takes so far, besides the statistics"""
        self.counts = Counter[int]()
        """Messages by channel."""
        self.message_count = 0
        self.start = self.end = 0
        """[ns] first and last log time; zeros without a message"""
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._indexes: dict[Opcode, list[bytes]] = {
            opcode: [] for opcode in (Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX)
        }
        self._write(MAGIC)
        self._write(pack_record(header))

    @property
    def path(self) -> Path:
        """The file."""
        return Path(self._stream.name)

    @property
    def fileno(self) -> int:
        """Descriptor of the open file."""
        return self._stream.fileno()

    @property
    def schemas(self) -> Mapping[int, Schema]:
        """Schemas by number."""
        return self._schemas

    @property
    def channels(self) -> Mapping[int, Channel]:
        """Channels by number."""
        return self._channels

    def add_schema(self, schema: Schema, *, in_chunk: bool = False) -> None:
        """Write a schema; ``in_chunk``: the next chunk contains it.

        Outside of the chunks, a damaged chunk does not take it along.
        """
        self._describe(self._schemas, schema, in_chunk)

    def add_channel(self, channel: Channel, *, in_chunk: bool = False) -> None:
        """Write a channel, whose schema was written before; ``in_chunk``: the next chunk contains it."""
        self._describe(self._channels, channel, in_chunk)

    def _describe(self, known: dict[int, Any], record: Schema | Channel, in_chunk: bool) -> None:
        packed = pack_record(record)
        if record.id not in known:
            self.index_size += len(packed)
        known[record.id] = record
        if not in_chunk:
            self._write(packed)

    def add_chunk(self, chunk: WholeChunk) -> None:
        """Write a chunk and its message index; its channels and schemas have the same numbers here."""
        place, offset = chunk.place, self.size
        for part in (*chunk.record, chunk.message_index):
            self._write(part)
        shift = offset - place.chunk_start_offset
        offsets = {channel: at + shift for channel, at in place.message_index_offsets.items()}
        self._add_index(
            Opcode.CHUNK_INDEX, pack_record(replace(place, chunk_start_offset=offset, message_index_offsets=offsets))
        )
        if count := sum(chunk.counts.values()):
            start = place.message_start_time
            self.start = min(self.start, start) if self.message_count else start
            self.end = max(self.end, place.message_end_time)
            self.message_count += count
            self.counts.update(chunk.counts)

    def add_attachment(self, time: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment that was made at ``time`` [ns]."""
        record = pack_record(Attachment(time, time, name, media_type, data))
        self.copy_record(AttachmentIndex(0, len(record), time, time, len(data), name, media_type), [record])

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        record = pack_record(Metadata(name=name, metadata=dict(values)))
        self.copy_record(MetadataIndex(0, len(record), name), [record])

    def copy_record(self, index: AttachmentIndex | MetadataIndex, blocks: Iterable[bytes]) -> None:
        """Write an attachment or metadata record of another file.

        Args:
            index: of the record there.
            blocks: the record, in parts.
        """
        opcode = Opcode.ATTACHMENT_INDEX if isinstance(index, AttachmentIndex) else Opcode.METADATA_INDEX
        packed = pack_record(replace(index, offset=self.size))
        for block in blocks:
            self._write(block)
        self._add_index(opcode, packed)

    def _add_index(self, opcode: Opcode, packed: bytes) -> None:
        self._indexes[opcode].append(packed)
        self.index_size += len(packed)

    def flush(self, sync: bool) -> None:
        """Hand everything to the operating system, so that it outlives the process; ``sync``: to the disk, too."""
        self._stream.flush()
        if sync:
            os.fsync(self._stream.fileno())

    def finish(self) -> None:
        """Write the index, bring the file to the disk and close it."""
        self._write(pack_record(DataEnd(0)))
        start, parts, offsets, at = self.size, list[bytes](), list[bytes](), self.size
        groups = {
            Opcode.SCHEMA: list(map(pack_record, self._schemas.values())),
            Opcode.CHANNEL: list(map(pack_record, self._channels.values())),
            Opcode.STATISTICS: [pack_record(self._statistics())],
            **self._indexes,
        }
        for opcode, records in groups.items():
            if length := sum(map(len, records)):
                offsets.append(pack_record(SummaryOffset(opcode, at, length)))
                parts += records
                at += length
        footer = FOOTER.pack(Opcode.FOOTER, FOOTER.size - RECORD.size, start, at, 0)[: -CRC.size]
        summary = b"".join((*parts, *offsets, footer))
        for part in (summary, CRC.pack(zlib.crc32(summary)), MAGIC):
            self._write(part)
        self.flush(sync=True)
        self._stream.close()

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._indexes[Opcode.ATTACHMENT_INDEX]),
            channel_count=len(self._channels),
            channel_message_counts=dict(sorted(self.counts.items())),
            chunk_count=len(self._indexes[Opcode.CHUNK_INDEX]),
            message_count=self.message_count,
            message_end_time=self.end,
            message_start_time=self.start,
            metadata_count=len(self._indexes[Opcode.METADATA_INDEX]),
            schema_count=len(self._schemas),
        )

    def abandon(self) -> None:
        """Close the file as it is, after an error; no effect after :meth:`finish`."""
        # Closing flushes the rest of the buffer, which fails on a full disk.
        with contextlib.suppress(OSError):
            self._stream.close()

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self.size += len(data)


def pack_record(record: Any) -> bytes:
    """Return the bytes of a record of the mcap library."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
