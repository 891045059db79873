"""Read one MCAP file of a bag: its index, and its messages block by block.

The index is read from the summary at the end of the file. A file without a summary is scanned. All functions raise a
DiffbotError if the file is damaged.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.exceptions import EndOfFile, InvalidMagic, McapError, RecordLengthLimitExceeded
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from diffbot_core.errors import DiffbotError, shown
from diffbot_core.files import MCAP, open_regular

MAX_RECORD = 2**30
"""[bytes] largest record that is read; a chunk of messages is one record"""
MAX_TIME = 2**63 - 1
"""[ns] largest log time of a bag"""


class Block(NamedTuple):
    """A chunk of a file, or all messages of a file without chunks; times in [ns]."""

    start: int
    end: int
    file: int
    """number of the file in the bag, from 0"""
    offset: int
    """[bytes] offset of the first record in the file"""
    stop: int
    """[bytes] offset after the last record in the file"""
    channels: frozenset[int]
    """channels that have messages in the block; empty if unknown"""


class Index(NamedTuple):
    """The contents of one file."""

    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]
    counts: Mapping[int, int]
    """number of messages by channel"""
    blocks: Sequence[Block]
    attachments: Mapping[str, int]
    """[bytes] offset of the newest attachment of each name"""
    unfinished: str = ""
    """reason why the file is not complete; empty for a complete file"""


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Convert every error of reading and parsing the file to a DiffbotError."""
    try:
        yield
    except DiffbotError:
        raise
    except InvalidMagic as error:
        raise DiffbotError(f"{shown(path)} is not an MCAP file") from error
    except OSError as error:
        raise DiffbotError(f"cannot read {shown(path)}: {error.strerror}") from error
    except Exception as error:  # damaged bytes make the parser and the decompressors raise errors of many types
        reason = "a record is cut off" if isinstance(error, EndOfFile) else shown(error) or type(error).__name__
        raise DiffbotError(
            f"{shown(path)} is damaged ({reason}): `diffbot bag repair` saves the intact messages"
        ) from error


def read_index(path: Path, number: int) -> Index:
    """Return the index of a file, from its summary or by a scan; ``number`` is the number of the file in the bag.

    Raises:
        DiffbotError: if the file is missing, not an MCAP file, or damaged.
    """
    with open_regular(path) as stream, _reading(path):
        size = os.fstat(stream.fileno()).st_size
        if size == 0:
            raise DiffbotError(f"{shown(path)} is an empty file")
        index = _from_summary(stream, size, number) or _from_scan(stream, size, number)
        if any(block.end > MAX_TIME for block in index.blocks):
            raise McapError("a log time is beyond the year 2262")
        return index


def _from_summary(stream: BinaryIO, size: int, number: int) -> Index | None:
    """Return the index from the summary; None if the file does not have a complete summary."""
    reader = SeekingReader(stream, record_size_limit=MAX_RECORD)  # checks the magic bytes
    summary = reader.get_summary() if _has_end(stream, size) else None
    if summary is None or summary.statistics is None:
        return None
    chunks, counts = summary.chunk_indexes, summary.statistics.channel_message_counts
    named = set(counts).union(*(chunk.message_index_offsets for chunk in chunks))
    if (summary.statistics.message_count and not chunks) or not named <= set(summary.channels):
        return None
    blocks = [
        Block(
            chunk.message_start_time,
            chunk.message_end_time,
            number,
            chunk.chunk_start_offset,
            chunk.chunk_start_offset + chunk.chunk_length,
            frozenset(chunk.message_index_offsets),
        )
        for chunk in chunks
        if chunk.uncompressed_size
    ]
    attachments = {attachment.name: attachment.offset for attachment in summary.attachment_indexes}
    return Index(summary.schemas, summary.channels, counts, blocks, attachments)


def _from_scan(stream: BinaryIO, size: int, number: int) -> Index:
    """Return the index by reading the whole file, or up to the last whole record if its writer was killed."""
    stream.seek(0)
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    counts = Counter[int]()
    attachments: dict[str, int] = {}
    blocks: list[Block] = []
    loose: Block | None = None
    end = len(MCAP)
    try:
        for record in StreamReader(stream, emit_chunks=True, record_size_limit=min(size, MAX_RECORD)).records:
            if isinstance(record, DataEnd):
                break
            begin, end = end, stream.tell()
            parts = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
            schemas |= {part.id: part for part in parts if isinstance(part, Schema)}
            channels |= {part.id: part for part in parts if isinstance(part, Channel)}
            if isinstance(record, Attachment):
                attachments[record.name] = begin
            messages = [part for part in parts if isinstance(part, Message)]
            counts.update(message.channel_id for message in messages)
            times = [message.log_time for message in messages]
            if isinstance(record, Chunk) and messages:
                with_messages = frozenset(message.channel_id for message in messages)
                blocks.append(Block(min(times), max(times), number, begin, end, with_messages))
            elif messages:
                first = loose or Block(times[0], times[0], number, begin, end, frozenset())
                loose = first._replace(start=min(first.start, *times), end=max(first.end, *times), stop=end)
        unfinished = "" if _has_end(stream, size) else "no index"
    except Exception as error:  # errors of many types, see _reading
        is_cut = isinstance(error, (EndOfFile, RecordLengthLimitExceeded)) or stream.tell() == size
        if not is_cut or isinstance(error, InvalidMagic):
            raise
        unfinished = "no index" + (f", and the last {size - end} bytes are an incomplete record" if size > end else "")
    if not set(counts) <= set(channels):
        raise McapError("messages of an unknown channel")
    return Index(schemas, channels, counts, [loose] if loose else blocks, attachments, unfinished)


def _has_end(stream: BinaryIO, size: int) -> bool:
    """Return True if a file of ``size`` [bytes] ends with the magic bytes, as every finished file does."""
    stream.seek(max(size - len(MCAP), len(MCAP)))
    return stream.read() == MCAP


def read_block(stream: BinaryIO, path: Path, block: Block) -> list[Message]:
    """Return the messages of a block in the order of the file; ``path`` is named in errors."""
    with _reading(path):
        messages = [record for record in _records(stream, block.offset, block.stop) if isinstance(record, Message)]
        if not messages:
            raise McapError("a block of the index has no messages")
        return messages


def read_attachment(stream: BinaryIO, path: Path, offset: int) -> bytes:
    """Return the data of the attachment at an offset [bytes]; ``path`` is named in errors."""
    with _reading(path):
        attachment = next(_records(stream, offset, offset))
        if not isinstance(attachment, Attachment):
            raise McapError("an attachment of the index is missing")
        return attachment.data


def _records(stream: BinaryIO, offset: int, stop: int) -> Iterator[McapRecord]:
    """Yield the records between two offsets [bytes]. A chunk is unpacked into its records."""
    stream.seek(offset)
    for record in StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=MAX_RECORD).records:
        yield from breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else (record,)
        if stream.tell() >= stop:
            return
