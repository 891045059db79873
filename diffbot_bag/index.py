"""One MCAP file of a bag: its contents by its summary, or by a scan if it was not finished; its messages, by blocks."""

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
"""[bytes] of one record that is read; a chunk of messages is one record"""
MAX_TIME = 2**63 - 1
"""[ns] largest log time of a bag"""


class Block(NamedTuple):
    """A chunk of a file, or all messages of a file without chunks; times in [ns]."""

    start: int
    end: int
    file: int
    """index of the file in the bag"""
    offset: int
    """[bytes] where its first record begins"""
    stop: int
    """[bytes] where its last record ends"""
    channels: frozenset[int]
    """channels with messages in the chunk; empty: unknown"""


class Index(NamedTuple):
    """The contents of one file."""

    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]
    counts: Mapping[int, int]
    """messages by channel"""
    blocks: Sequence[Block]
    attachments: Mapping[str, int]
    """[bytes] offset of the last attachment of each name"""
    unfinished: str = ""
    """reason why the file is not complete; empty if it is"""


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Report whatever fails while a file is read and parsed as one line."""
    try:
        yield
    except DiffbotError:
        raise
    except InvalidMagic as error:
        raise DiffbotError(f"{shown(path)} is not an MCAP file") from error
    except OSError as error:
        raise DiffbotError(f"cannot read {shown(path)}: {error.strerror}") from error
    except Exception as error:  # the parser and the decompression of damaged bytes raise any
        what = "a record without an end" if isinstance(error, EndOfFile) else shown(error) or type(error).__name__
        raise DiffbotError(f"{shown(path)} is damaged ({what}): `diffbot bag repair` saves what is intact") from error


def read_index(path: Path, number: int) -> Index:
    """Return the contents of a file, from its summary or by a scan; ``number`` is the file's index in the bag.

    Raises:
        DiffbotError: if the file is missing, not an MCAP file, or damaged.
    """
    with open_regular(path) as stream, _reading(path):
        size = os.fstat(stream.fileno()).st_size
        if size == 0:
            raise DiffbotError(f"{shown(path)} is an empty file")
        index = _from_summary(stream, size, number) or _from_scan(stream, size, number)
        if any(block.end > MAX_TIME for block in index.blocks):
            raise McapError("a log time beyond the year 2262")
        return index


def _from_summary(stream: BinaryIO, size: int, number: int) -> Index | None:
    """Return the contents of a file by its summary; None if the file has no summary or an incomplete one."""
    reader = SeekingReader(stream, record_size_limit=MAX_RECORD)  # checks the magic at the beginning
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
    attachments = {one.name: one.offset for one in summary.attachment_indexes}
    return Index(summary.schemas, summary.channels, counts, blocks, attachments)


def _from_scan(stream: BinaryIO, size: int, number: int) -> Index:
    """Return the contents of a file by reading all of it, up to the last whole record if its writer was killed."""
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
                of = frozenset(message.channel_id for message in messages)
                blocks.append(Block(min(times), max(times), number, begin, end, of))
            elif messages:
                first = loose or Block(times[0], times[0], number, begin, end, frozenset())
                loose = first._replace(start=min(first.start, *times), end=max(first.end, *times), stop=end)
        unfinished = "" if _has_end(stream, size) else "no index"
    except Exception as error:  # as in _reading
        is_cut = isinstance(error, (EndOfFile, RecordLengthLimitExceeded)) or stream.tell() == size
        if not is_cut or isinstance(error, InvalidMagic):
            raise
        unfinished = "no index" + (f", and the last {size - end} bytes are an incomplete record" if size > end else "")
    if not set(counts) <= set(channels):
        raise McapError("messages without a channel")
    return Index(schemas, channels, counts, [loose] if loose else blocks, attachments, unfinished)


def _has_end(stream: BinaryIO, size: int) -> bool:
    """Return True if the magic stands at the end of a file of ``size`` [bytes], too, as in every finished file."""
    stream.seek(max(size - len(MCAP), len(MCAP)))
    return stream.read() == MCAP


def read_block(stream: BinaryIO, path: Path, block: Block) -> list[Message]:
    """Return the messages of a block of the open file in the order of the file; ``path`` is for the error.

    Raises:
        DiffbotError: if the file is damaged.
    """
    with _reading(path):
        messages = [one for one in _records(stream, block.offset, block.stop) if isinstance(one, Message)]
        if not messages:
            raise McapError("no message where the index has some")
        return messages


def read_attachment(stream: BinaryIO, path: Path, offset: int) -> bytes:
    """Return the data of the attachment at an offset [bytes] of the open file; ``path`` is for the error.

    Raises:
        DiffbotError: if the file is damaged.
    """
    with _reading(path):
        attachment = next(_records(stream, offset, offset))
        if not isinstance(attachment, Attachment):
            raise McapError("no attachment where the index has one")
        return attachment.data


def _records(stream: BinaryIO, offset: int, stop: int) -> Iterator[McapRecord]:
    """Yield the records from one offset [bytes] to another, those of chunks one by one."""
    stream.seek(offset)
    for record in StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=MAX_RECORD).records:
        yield from breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else (record,)
        if stream.tell() >= stop:
            return
