"""Repair a bag: write the intact messages of a damaged or unfinished bag to a new one."""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, DataEnd, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary

from diffbot_bag.bag import topic_of
from diffbot_bag.bag_files import LIBRARY
from diffbot_bag.index import MAX_RECORD, MAX_TIME
from diffbot_bag.metadata import FILE_NAME, BagMetadata, Topic, path_inside, without_losses
from diffbot_bag.metadata import read as read_metadata
from diffbot_bag.writer import BagWriter, new_bag
from diffbot_core.errors import DiffbotError, shown
from diffbot_core.files import MCAP, expanded, open_regular

_RECORD = struct.Struct("<BQ")
"""Opcode and length of a record."""
_CHUNK = struct.Struct("<BQQQQII")
"""Opcode, length, start, end, uncompressed size, checksum, and length of the name of the compression."""
_SIZE = struct.Struct("<Q")
"""Size of the compressed records of a chunk."""
_RECORD_PATTERN = re.compile(rb"[\x01-\x0f](?=.{5}\0{3})", re.DOTALL)
"""Opcode and length of a record that is shorter than 1 TiB."""
_BLOCK, _OVERLAP = 2**20, 8
"""[bytes] size of the parts in which a file is searched, and of the overlap that the pattern needs"""
_CHAIN = 3
"""number of consecutive plausible records that mark the end of a damaged place"""
_PARSED = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.ATTACHMENT, Opcode.DATA_END}


class _DamagedError(Exception):
    """A record is damaged."""


class Damage(NamedTuple):
    """A damaged place of a file."""

    file: str
    size: int
    """[bytes]"""
    before: int | None
    """[ns] log time of the last saved message before it in this file; None if there is none"""
    after: int | None
    """[ns] log time of the first saved message after it; None if there is none"""


class Repaired(NamedTuple):
    """Metadata of the repaired bag, and a list of the losses."""

    metadata: BagMetadata
    damages: list[Damage]
    lost: Counter[str]
    """number of lost messages by topic: messages that the index counts and that could not be saved"""
    without_index: list[str]
    """files without a valid index: cut off, not finished, or damaged at the end"""
    missing: list[str]
    """files that metadata.yaml names but that do not exist"""
    unknown: list[str]
    """substitute names of topics whose names are lost"""


class _Scan:
    """Reader of the records of an MCAP file that continues after damaged places."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._size = os.fstat(stream.fileno()).st_size

    def pieces(self) -> Iterator[tuple[int, list[Any] | None]]:
        """Yield size [bytes] and records of each chunk or other record of the file.

        The records are None for a damaged place, and empty for a record that a repair does not need, such as an index.
        """
        at = len(MCAP)
        while at < self._size:
            records: list[Any] | None
            try:
                records, end = self._read(at)
            except _DamagedError:
                records, end = None, self._offset_after(at)
            yield end - at, records
            if records and isinstance(records[0], DataEnd):
                return
            at = end

    def _bytes(self, at: int, size: int) -> bytes:
        self._stream.seek(at)
        return self._stream.read(size)

    def _read(self, at: int) -> tuple[list[Any], int]:
        """Return the records at an offset, and the offset after them.

        Raises:
            _DamagedError: if the record at the offset is damaged.
        """
        end, opcode = self._end(at), self._bytes(at, 1)[0]
        # If opcode or length may be damaged, try to read a chunk: its checksum shows whether it is intact.
        if opcode == Opcode.CHUNK or end is None or not (self._end(end) is not None or self._is_chunk(end)):
            return self._read_chunk(at)
        if opcode not in _PARSED:
            return [], end
        content = self._bytes(at + _RECORD.size, end - at - _RECORD.size)
        if opcode == Opcode.ATTACHMENT and zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], "little"):
            raise _DamagedError
        self._stream.seek(at)
        reader = StreamReader(self._stream, skip_magic=True, record_size_limit=MAX_RECORD)
        return [_parsed(lambda: next(reader.records))], end

    def _read_chunk(self, at: int) -> tuple[list[Any], int]:
        head = self._bytes(at, _CHUNK.size + 4 + _SIZE.size)
        try:
            opcode, length, start, last, size, checksum, name_length = _CHUNK.unpack_from(head)
            name = head[_CHUNK.size : _CHUNK.size + name_length]
            (packed,) = _SIZE.unpack_from(head, _CHUNK.size + name_length)
        except struct.error as error:
            raise _DamagedError from error
        first = at + _CHUNK.size + name_length + _SIZE.size
        is_exact = (opcode, first + packed) == (Opcode.CHUNK, at + _RECORD.size + length)
        if name not in (b"", b"lz4", b"zstd") or max(packed, size) > MAX_RECORD or not (is_exact or checksum):
            raise _DamagedError
        data = self._bytes(first, packed)
        if len(data) < packed:
            raise _DamagedError
        chunk = Chunk(name.decode(), data, last, start, checksum, size)
        return _parsed(lambda: breakup_chunk(chunk, validate_crc=True)), first + packed

    def _end(self, at: int) -> int | None:
        """Return the end of a record at an offset, or of the file; None if no record can begin at the offset."""
        prefix = self._bytes(at, _RECORD.size)
        if len(prefix) < _RECORD.size:
            return at if at == self._size else None
        opcode, length = _RECORD.unpack(prefix)
        end: int = at + _RECORD.size + length
        return end if 0 < opcode <= Opcode.DATA_END and end <= self._size else None

    def _offset_after(self, damaged: int) -> int:
        """Return the offset at which to continue after a damaged record.

        This is the end of the record, if another record begins there. Otherwise it is the next intact chunk or chain of
        plausible records, or the end of the file.
        """
        end = self._end(damaged)
        if end is not None and end < self._size and self._end(end) is not None:
            return end
        for at in range(damaged + 1, self._size, _BLOCK):
            for found in _RECORD_PATTERN.finditer(self._bytes(at, _BLOCK + _OVERLAP)):
                start = at + found.start()
                if found.start() < _BLOCK and (self._is_chain(start) or self._is_chunk(start)):
                    return start
        return self._size

    def _is_chunk(self, at: int) -> bool:
        try:
            return bool(self._read_chunk(at)[0])
        except _DamagedError:
            return False

    def _is_chain(self, at: int) -> bool:
        end: int | None = at
        for _ in range(_CHAIN):
            end = None if end is None else self._end(end)
        return end is not None


def _parsed(read: Callable[[], Any]) -> Any:
    try:
        return read()
    except OSError:
        raise
    except Exception as error:  # damaged bytes make the library and the decompressors raise errors of many types
        raise _DamagedError from error


def repair_bag(source: Path, target: Path, progress: Callable[[int], None] = lambda _: None) -> Repaired:
    """Write the intact messages and attachments of a bag to a new bag.

    Args:
        source: folder or MCAP file.
        target: folder of the new bag, which must not exist. It appears when the bag is complete.
        progress: called with the number of bytes read since its last call.

    Raises:
        DiffbotError: if the bag is missing, a file changes during the repair, or the new bag cannot be written.
    """
    files, missing, stored = _find_files(expanded(source))
    with new_bag(target) as writer:
        copy = _Copy(writer, stored.topics if stored else ())
        for path in files:
            with open_regular(path) as stream:
                before = os.fstat(stream.fileno())
                if stream.read(len(MCAP)) != MCAP:
                    raise DiffbotError(f"{shown(path)} is not an MCAP file")
                copy.copy_file(path.name, stream, progress)
                after = os.stat(path)
            if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
                raise DiffbotError(f"{shown(path)} has changed while it was read: is it still being recorded?")
        lost, notes = +copy.lost, stored.custom_data if stored else {}
        is_intact = not (copy.damages or lost or copy.without_index or missing)
        # The recorder has not counted messages that are lost by damage; `bag info` counts them by sequence numbers.
        writer.custom_data = notes if is_intact else without_losses(notes)
    return Repaired(read_metadata(target), copy.damages, lost, copy.without_index, missing, copy.unknown)


def _find_files(bag: Path) -> tuple[list[Path], list[str], BagMetadata | None]:
    """Return the existing files of a bag, the names of missing files, and the metadata if it can be read.

    Files that metadata.yaml names come first, then all other MCAP files of the folder.
    """
    if not bag.is_dir():
        return [bag], [], None
    try:
        stored = read_metadata(bag) if (bag / FILE_NAME).exists() else None
    except DiffbotError:
        stored = None
    # Sort run_2 before run_10.
    found = sorted((path.name for path in bag.glob("*.mcap")), key=lambda name: (len(name), name))
    named = [file.name for file in stored.files] if stored else []
    paths = {name: path_inside(bag, name) for name in [*named, *found]}
    # Path.exists raises an error for a name that is too long.
    files = {name: path for name, path in paths.items() if os.path.exists(path)}
    if not files:
        raise DiffbotError(f"no bag in {shown(bag)}: it does not contain an MCAP file")
    return [*files.values()], [name for name in paths if name not in files], stored


class _Copy:
    """Copies files to a writer and counts the losses."""

    def __init__(self, writer: BagWriter, stored: tuple[Topic, ...]) -> None:
        """Start without files; ``stored`` are the topics of metadata.yaml, in their order."""
        self._writer, self._stored = writer, stored
        self._numbers: dict[tuple[str, str], int] = {}
        """channel of the new bag by topic and type"""
        self._attached: dict[str, bytes] = {}
        self.damages: list[Damage] = []
        self.lost: Counter[str] = Counter()
        self.without_index: list[str] = []
        self.unknown: list[str] = []

    def copy_file(self, name: str, stream: BinaryIO, progress: Callable[[int], None]) -> None:
        """Copy the intact messages and attachments of a file."""
        summary, is_own = _summary_of(stream)
        if summary is None:
            self.without_index.append(name)
            summary = Summary()
        if summary.statistics is None or not set(summary.statistics.channel_message_counts) <= set(summary.channels):
            _add_definitions(summary, stream)
        numbers: dict[int, int] = {}
        counts: Counter[int] = Counter()
        damage: Damage | None = None
        last: int | None = None
        for size, records in _Scan(stream).pieces():
            progress(size)
            if records is None:
                damage = Damage(name, size, last, None)
                self.damages.append(damage)
            for record in records or ():
                # Copy an attachment once: each file of a bag repeats it.
                if isinstance(record, Attachment) and self._attached.get(record.name) != record.data:
                    self._attached[record.name] = record.data
                    self._writer.attach(record.name, record.media_type, record.data)
                if not isinstance(record, Message) or record.log_time > MAX_TIME:
                    continue
                number, last = record.channel_id, record.log_time
                if number not in numbers:
                    numbers[number] = self._channel(number, summary, self._stored if is_own else ())
                publish_time = min(record.publish_time, MAX_TIME)
                self._writer.write(numbers[number], record.data, last, publish_time, record.sequence)
                counts[number] += 1
                if damage is not None:
                    self.damages[-1], damage = damage._replace(after=last), None
        for number, count in summary.statistics.channel_message_counts.items() if summary.statistics else ():
            known = summary.channels.get(number)
            self.lost[known.topic if known else _unknown(number)] += count - counts[number]

    def _channel(self, number: int, known: Summary, stored: tuple[Topic, ...]) -> int:
        """Return the channel of the new bag for channel ``number`` of a file; ``stored`` lists topics by channel."""
        channel = known.channels.get(number)
        schema = known.schemas.get(channel.schema_id) if channel else None
        if channel is not None:
            try:
                topic = topic_of(channel, schema)
            except DiffbotError:  # the QoS is damaged
                channel.metadata = {}
                topic = topic_of(channel, schema)
        elif 0 < number <= len(stored):
            topic = stored[number - 1]
        else:
            topic = Topic(_unknown(number), "")
            self.unknown.append(topic.name)
        key = topic.name, topic.type
        if key not in self._numbers:
            self._numbers[key] = self._writer.add_topic(
                topic.name, topic.type, topic.qos, topic.type_hash, encoding=topic.encoding, schema=schema
            )
        return self._numbers[key]


def _unknown(number: int) -> str:
    return f"/unknown/channel_{number}"


def _summary_of(stream: BinaryIO) -> tuple[Summary | None, bool]:
    """Return the summary of a file (None if missing or damaged), and True if BagWriter wrote it."""

    def read(part: Callable[[], Any]) -> Any:
        try:
            return _parsed(part)
        except _DamagedError:
            return None

    stream.seek(0)
    reader = SeekingReader(stream, record_size_limit=MAX_RECORD)
    return read(reader.get_summary), read(lambda: reader.get_header().library) == LIBRARY


def _add_definitions(summary: Summary, stream: BinaryIO) -> None:
    """Add all intact schemas and channels of a file to the summary."""
    for _, records in _Scan(stream).pieces():
        for record in records or ():
            if isinstance(record, Schema):
                summary.schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                summary.channels.setdefault(record.id, record)
