"""Index of a file that its writer did not finish: read up to the end, or to the record within which the file ends."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any, BinaryIO

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Message, Schema, Statistics

from diffbot_bag.chunks import BagLimits
from diffbot_bag.mcap_format import McapSummary
from diffbot_bag.record_scan import ChunkPiece, Gap, Piece, RecordScan, parse_record


def scan_unfinished(stream: BinaryIO, size: int, limits: BagLimits) -> tuple[McapSummary, int]:
    """Return the index of a file of ``size`` bytes, and the bytes of the record within which it ends.

    Raises:
        McapError: if anything before that is damaged.
        DiffbotError: if its chunks unpack to more than the limits allow.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    chunks: list[ChunkIndex] = []
    counts: Counter[int] = Counter()
    first, last, end = [], [], size

    def define(record: Any) -> None:
        (schemas if isinstance(record, Schema) else channels).setdefault(record.id, record)

    for piece in _intact(stream, size, limits):
        if isinstance(piece, Gap):
            end = piece.offset
        elif isinstance(piece, ChunkPiece):
            for opcode, content in piece.indexes.definitions:
                define(parse_record(opcode, content))
            counts.update({channel: len(found) // 2 for channel, found in piece.indexes.entries.items()})
            if piece.indexes.entries:
                chunks.append(_index_of(piece))
                first.append(piece.chunk.message_start_time)
                last.append(piece.chunk.message_end_time)
        elif piece.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            define(piece.record())
        elif piece.opcode == Opcode.MESSAGE:
            message = piece.record()
            counts[message.channel_id] += 1
            first = [min([message.log_time, *first])]
            last = [max([message.log_time, *last])]
    if unknown := counts.keys() - channels.keys():
        raise McapError(f"messages of a channel {min(unknown)} without a description")
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(channels),
        channel_message_counts=dict(counts),
        chunk_count=len(chunks),
        message_count=counts.total(),
        message_end_time=max(last, default=0),
        message_start_time=min(first, default=0),
        metadata_count=0,
        schema_count=len(schemas),
    )
    return McapSummary(end, schemas, channels, chunks, statistics), size - end


def scan_messages(stream: BinaryIO, size: int, limits: BagLimits) -> Iterator[Message]:
    """Iterate over the messages outside of chunks, in the order of the file.

    Raises:
        McapError: if the file is damaged.
    """
    for piece in _intact(stream, size, limits):
        if isinstance(piece, Piece) and piece.opcode == Opcode.MESSAGE:
            yield piece.record()


def _intact(stream: BinaryIO, size: int, limits: BagLimits) -> Iterator[Piece | ChunkPiece | Gap]:
    """Iterate over the records of a file; the only gap may be at its end."""
    for piece in RecordScan(stream, size, limits).pieces():
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
