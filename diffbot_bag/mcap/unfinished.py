"""Index of a file that its writer did not finish: read up to the end, or to the record within which the file ends."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any, BinaryIO

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Message, Schema, Statistics

from diffbot_bag.mcap.chunks import BagLimits
from diffbot_bag.mcap.format import MAX_INDEX, McapSummary
from diffbot_bag.mcap.scan import ChunkPiece, Gap, Piece, RecordScan, parse_record
from diffbot_core.errors import DiffbotError


class _Index:
    """Collects what a summary would say."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.chunks: list[ChunkIndex] = []
        self._counts: Counter[int] = Counter()
        self._start: int | None = None
        self._end = 0
        self._size = 0

    def take(self, piece: Piece | ChunkPiece) -> None:
        if isinstance(piece, ChunkPiece):
            for opcode, content in piece.indexes.definitions:
                self._define(parse_record(opcode, content), len(content))
            if piece.indexes.entries:
                self.chunks.append(_index_of(piece))
                self._extend(piece.chunk.message_start_time, piece.chunk.message_end_time)
            for channel, found in piece.indexes.entries.items():
                self._counts[channel] += len(found) // 2
        elif piece.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._define(piece.record(), len(piece.content))
        elif piece.opcode == Opcode.MESSAGE:
            message = piece.record()
            self._counts[message.channel_id] += 1
            self._extend(message.log_time, message.log_time)

    def _define(self, record: Any, size: int) -> None:
        kept: dict[int, Any] = self.schemas if isinstance(record, Schema) else self.channels
        if record.id not in kept:
            kept[record.id] = record
            self._size += size
        if self._size > MAX_INDEX:
            raise DiffbotError(f"descriptions of {self._size} bytes: must be <= {MAX_INDEX}")

    def _extend(self, start: int, end: int) -> None:
        self._start = start if self._start is None else min(self._start, start)
        self._end = max(self._end, end)

    def statistics(self) -> Statistics:
        if unknown := self._counts.keys() - self.channels.keys():
            raise McapError(f"messages of a channel {min(unknown)} without a description")
        return Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self.chunks),
            message_count=self._counts.total(),
            message_end_time=self._end,
            message_start_time=self._start or 0,
            metadata_count=0,
            schema_count=len(self.schemas),
        )


def scan_unfinished(stream: BinaryIO, size: int, limits: BagLimits) -> tuple[McapSummary, int]:
    """Return the index of a file of ``size`` bytes, and the bytes of the record within which it ends.

    Raises:
        McapError: if anything before that is damaged.
        DiffbotError: if its chunks unpack to more than the limits allow.
    """
    index, end = _Index(), size
    for piece in _intact(stream, size, limits):
        if isinstance(piece, Gap):
            end = piece.offset
        else:
            index.take(piece)
    return McapSummary(end, index.schemas, index.channels, index.chunks, index.statistics(), []), size - end


def scan_messages(stream: BinaryIO, size: int, limits: BagLimits, end: int) -> Iterator[Message]:
    """Iterate over the messages of a file whose index names no chunk, in the order of the file.

    Args:
        stream: of the file.
        size: [bytes] of the file.
        limits: how much it may unpack to.
        end: [bytes] where its summary begins, or its incomplete last record.

    Raises:
        McapError: if the file is damaged, or has a chunk with messages.
    """
    for piece in _intact(stream, size, limits, end):
        if isinstance(piece, ChunkPiece) and piece.indexes.entries:
            raise McapError("chunks that the index does not name")
        if isinstance(piece, Piece) and piece.opcode == Opcode.MESSAGE:
            yield piece.record()


def _intact(
    stream: BinaryIO, size: int, limits: BagLimits, end: int | None = None
) -> Iterator[Piece | ChunkPiece | Gap]:
    """Iterate over the records of a file; the only gap may be at its end."""
    for piece in RecordScan(stream, size, limits, end).pieces():
        if isinstance(piece, Gap) and not piece.is_cut:
            raise McapError(f"{piece.reason}, at byte {piece.offset}")
        if isinstance(piece, ChunkPiece) and not piece.is_exact:
            raise McapError(f"head of a chunk, at byte {piece.offset}")
        yield piece


def _index_of(piece: ChunkPiece) -> ChunkIndex:
    chunk = piece.chunk
    return ChunkIndex(
        chunk_length=piece.end - piece.offset,
        chunk_start_offset=piece.offset,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )
