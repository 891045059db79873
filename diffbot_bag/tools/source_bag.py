"""A bag whose chunks are copied: their bytes as they stand in the file, or their messages."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator, Mapping
from operator import itemgetter
from typing import Any, BinaryIO

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, ChunkIndex, MetadataIndex, Schema

from diffbot_bag.bag.metadata import RECORD_NAME, TEXT_KEY
from diffbot_bag.bag.reader import BagReader
from diffbot_bag.mcap.attachments import blocks_of
from diffbot_bag.mcap.chunks import records_in, verified_chunk
from diffbot_bag.mcap.file import McapFile
from diffbot_bag.mcap.format import MESSAGE, RECORD
from diffbot_bag.mcap.scan import parse_record
from diffbot_bag.mcap.whole_chunk import WholeChunk, check_chunk, chunk_end
from diffbot_bag.tools.span import Span
from diffbot_core.bounded_yaml import load_yaml
from diffbot_core.errors import DiffbotError

Row = tuple[int, int, bytes]
"""Log time [ns], channel and the rest of a message: sequence number, both times and data, as MCAP stores them."""
MAX_METADATA = 2**20
"""[bytes] of the metadata record that rosbag2 writes into a file"""
_TAIL = struct.Struct("<IQQ")
"""Sequence number, log time, publish time; the data follow."""


class SourceFile(McapFile):
    """One file of a bag, with access to its chunks."""

    @property
    def chunks(self) -> list[ChunkIndex]:
        """Index of the chunks in the order of the file; empty if the messages are not in chunks."""
        return self._chunks

    @property
    def channels(self) -> dict[int, Channel]:
        """Channels by number."""
        return self._channels

    @property
    def schemas(self) -> dict[int, Schema]:
        """Schemas by number."""
        return self._schemas

    @property
    def size(self) -> int:
        """Size of the file [bytes]."""
        return self._size

    @property
    def attached(self) -> list[AttachmentIndex | MetadataIndex]:
        """Index of attachments and metadata records, without those that describe the bag."""
        return [one for one in self._attached if isinstance(one, AttachmentIndex) or one.name != RECORD_NAME]

    def attached_bytes(self, index: AttachmentIndex | MetadataIndex) -> Iterator[bytes]:
        """Yield the record of an attachment or of metadata, in blocks.

        Raises:
            DiffbotError: if it is not where the index has it.
        """
        expected = Opcode.ATTACHMENT if isinstance(index, AttachmentIndex) else Opcode.METADATA
        with self._damage_as_error():
            self._stream.seek(index.offset)
            opcode, length = RECORD.unpack(self._stream.read(RECORD.size))
            if opcode != expected or length + RECORD.size != index.length or index.offset + index.length > self._size:
                raise McapError("no attachment where the index has one")
            yield from blocks_of(self._stream, index.offset, index.length)

    def whole_chunk(self, index: ChunkIndex) -> WholeChunk | None:
        """Return a chunk without unpacking it; None if its messages can only be counted by unpacking.

        Raises:
            DiffbotError: if it is not what the index says.
        """
        offsets = index.message_index_offsets
        if not offsets or min(offsets.values()) != chunk_end(index):
            return None
        with self._damage_as_error():
            if chunk_end(index) + index.message_index_length > self._size:
                raise McapError("a message index beyond the file")
            self._stream.seek(index.chunk_start_offset)
            record, message_index = (self._stream.read(n) for n in (index.chunk_length, index.message_index_length))
            chunk = check_chunk(index, record, message_index)
            if not chunk.counts.keys() <= self._channels.keys():
                raise McapError("a channel that the index does not name")
        return chunk

    def chunk_rows(self, index: ChunkIndex | None, channels: Mapping[int, int | None], span: Span) -> list[Row]:
        """Return messages in the order of log time, under new channel numbers.

        Args:
            index: their chunk; None for a file without chunks.
            channels: new number of each channel; None for one that is left out.
            span: of the log times to keep.

        Raises:
            DiffbotError: if the chunk is damaged.
        """
        with self._damage_as_error():
            if index is None:
                return [
                    (one.log_time, number, _TAIL.pack(one.sequence, one.log_time, one.publish_time) + one.data)
                    for one in self._messages_without_chunks(False)
                    if span.start <= one.log_time < span.end and (number := channels[one.channel_id]) is not None
                ]
            return _rows(self._stream, index, channels, span)

    def own_metadata(self) -> dict[str, Any]:
        """Return what rosbag2 wrote about the bag into the file itself; empty if there is nothing of the kind."""
        records = [one for one in self._attached if isinstance(one, MetadataIndex) and one.name == RECORD_NAME]
        if not records:
            return {}
        with contextlib.suppress(DiffbotError), self._damage_as_error():
            self._stream.seek(records[-1].offset)
            opcode, length = RECORD.unpack(self._stream.read(RECORD.size))
            if opcode == Opcode.METADATA and length <= MAX_METADATA:
                record = parse_record(opcode, self._stream.read(length))
                content = load_yaml(record.metadata.get(TEXT_KEY, ""), TEXT_KEY)
                return content if isinstance(content, dict) else {}
        return {}


def _rows(stream: BinaryIO, index: ChunkIndex, channels: Mapping[int, int | None], span: Span) -> list[Row]:
    data = verified_chunk(stream, index).data
    rows = []
    for opcode, at, end in records_in(data, index.chunk_length):
        if opcode == Opcode.MESSAGE:
            channel, _, log_time, _ = MESSAGE.unpack_from(data, at)
            number = channels[channel]
            if number is not None and span.start <= log_time < span.end:
                rows.append((log_time, number, data[at + 2 : end]))
    rows.sort(key=itemgetter(0))
    if rows and not index.message_start_time <= rows[0][0] <= rows[-1][0] <= index.message_end_time:
        raise McapError("a message outside of its chunk's times")
    return rows


class SourceBag(BagReader):
    """A bag whose chunks are copied."""

    _file_type = SourceFile
    _files: list[SourceFile]  # type: ignore[assignment]

    def __enter__(self) -> SourceBag:
        """Return the bag itself."""
        return self

    @property
    def files(self) -> list[SourceFile]:
        """Its files, in the order of recording."""
        return self._files

    @property
    def span(self) -> Span:
        """Log times of the bag: of its first message, and just after its last."""
        return Span(self.start, self.end + 1)
