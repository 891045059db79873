"""Write an MCAP file of whole chunks of other files, and of messages that are packed into new chunks.

The mcap library writes messages only; its records are used here for all but the chunks.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from diffbot_bag.mcap_format import CRC, FOOTER, MAGIC
from diffbot_bag.tools.source_bag import Row
from diffbot_bag.tools.whole_chunk import ENTRY_SIZE, RECORD, WholeChunk, pack_chunk

CHUNK_SIZE = 768 * 1024
"""[bytes] of a new chunk before it is packed, as rosbag2's"""
_PREFIX = struct.Struct("<BQH")
"""Opcode, length and channel of a message."""
ENVELOPE = _PREFIX.size + ENTRY_SIZE
"""[bytes] of a message besides the rest that a row holds"""
_INDEX_SIZE = 100
"""[bytes] of a chunk in the index of the file, without its channels"""
_MARGIN = 2000
"""[bytes] statistics, footer, and the frame of a chunk"""


class OutputFile:
    """One MCAP file that is being written. Errors of the disk are OSErrors; the caller closes it then."""

    def __init__(
        self, path: Path, schemas: Mapping[int, Schema], channels: Mapping[int, Channel], compression: str
    ) -> None:
        """Create the file with all its schemas and channels.

        Args:
            path: a new file in an existing folder.
            schemas: by number.
            channels: by number; all that will have messages.
            compression: of new chunks: zstd, lz4 or none (empty).

        Raises:
            OSError: if it cannot be written.
        """
        self.path = path
        self.counts: dict[int, int] = dict.fromkeys(channels, 0)
        self.start = self.end = 0
        self._schemas, self._channels = schemas, channels
        self._compression = compression
        self._chunks: list[ChunkIndex] = []
        self._attached: list[AttachmentIndex | MetadataIndex] = []
        self._parts: list[bytes] = []
        self._entries: dict[int, list[int]] = {}
        self._held = 0
        self._stream = path.open("xb")
        self._stream.write(MAGIC)
        head = _records([Header("ros2", "diffbot"), *schemas.values(), *channels.values()])
        self._stream.write(head)
        self._head = len(head)

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return sum(self.counts.values())

    @property
    def size(self) -> int:
        """Size [bytes] that the file would have at most if it ended now, without its metadata record."""
        channels = len(self._channels)
        index = self._head + len(self._chunks) * (_INDEX_SIZE + 10 * channels)
        pending = self._held + ENTRY_SIZE * (len(self._parts) // 2) + 25 * channels
        return self._stream.tell() + index + pending + _MARGIN

    def write(self, rows: Iterable[Row]) -> None:
        """Append messages; they may come in any order, but readers are fastest in that of log time.

        Raises:
            OSError: if the disk is full.
        """
        held = self._held
        for log_time, channel, tail in rows:
            entries = self._entries.get(channel)
            if entries is None:
                entries = self._entries[channel] = []
            entries += (log_time, held)
            self._parts += (_PREFIX.pack(Opcode.MESSAGE, len(tail) + 2, channel), tail)
            held += _PREFIX.size + len(tail)
            if held >= CHUNK_SIZE:
                self._held = held
                self.flush()
                held = 0
        self._held = held

    def copy(self, chunk: WholeChunk) -> None:
        """Append a chunk as it is; its channels and schemas have the same numbers here.

        Raises:
            OSError: if the disk is full.
        """
        self.flush()
        self._append(chunk)

    def flush(self) -> None:
        """End the chunk in progress, so that what was written is counted.

        Raises:
            OSError: if the disk is full.
        """
        if self._parts:
            chunk = pack_chunk(self._parts, self._entries, self._compression)
            self._parts, self._entries = [], {}
            self._held = 0
            self._append(chunk)

    def _append(self, chunk: WholeChunk) -> None:
        offset = self._stream.tell()
        self._stream.write(chunk.record)
        self._stream.write(chunk.message_index)
        shift = offset - chunk.place.chunk_start_offset
        offsets = {number: at + shift for number, at in chunk.place.message_index_offsets.items()}
        self._chunks.append(replace(chunk.place, chunk_start_offset=offset, message_index_offsets=offsets))
        if any(chunk.counts.values()):
            start = chunk.place.message_start_time
            self.start = min(self.start, start) if self.message_count else start
            self.end = max(self.end, chunk.place.message_end_time)
        for channel, count in chunk.counts.items():
            self.counts[channel] += count

    def attach(self, index: AttachmentIndex | MetadataIndex, blocks: Iterable[bytes]) -> None:
        """Append an attachment or metadata record of another file.

        Raises:
            OSError: if the disk is full.
        """
        self.flush()
        self._attached.append(replace(index, offset=self._stream.tell()))
        for block in blocks:
            self._stream.write(block)

    def add_metadata(self, name: str, content: dict[str, str]) -> None:
        """Append a metadata record.

        Raises:
            OSError: if the disk is full.
        """
        self.flush()
        record = _records([Metadata(name=name, metadata=content)])
        self._attached.append(MetadataIndex(offset=self._stream.tell(), length=len(record), name=name))
        self._stream.write(record)

    def finish(self) -> None:
        """Write the index, bring everything to the disk and close the file.

        Raises:
            OSError: if the disk is full.
        """
        self.flush()
        self._stream.write(_records([DataEnd(0)]))
        begin, summary, groups = self._stream.tell(), RecordBuilder(), []
        for opcode, records in self._summary():
            at = summary.count
            for record in records:
                record.write(summary)
            if summary.count > at:
                groups.append(SummaryOffset(opcode, begin + at, summary.count - at))
        data = bytes(summary.end())  # type: ignore[no-untyped-call]
        offsets = _records(groups)
        footer = FOOTER.pack(Opcode.FOOTER, FOOTER.size - RECORD.size, begin, begin + len(data), 0)[: -CRC.size]
        checksum = zlib.crc32(data + offsets + footer)
        for part in (data, offsets, footer, CRC.pack(checksum), MAGIC):
            self._stream.write(part)
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()

    def _summary(self) -> list[tuple[Opcode, Sequence[Any]]]:
        attachments = [one for one in self._attached if isinstance(one, AttachmentIndex)]
        records = [one for one in self._attached if isinstance(one, MetadataIndex)]
        statistics = Statistics(
            message_count=self.message_count,
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=len(attachments),
            metadata_count=len(records),
            chunk_count=len(self._chunks),
            message_start_time=self.start,
            message_end_time=self.end,
            channel_message_counts=self.counts,
        )
        return [
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, attachments),
            (Opcode.METADATA_INDEX, records),
        ]

    def close(self) -> None:
        """Close the file as it is; no effect after :meth:`finish`."""
        # Closing writes the rest of the buffer, which fails on a full disk.
        with contextlib.suppress(OSError):
            self._stream.close()


def _records(records: Iterable[Any]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
