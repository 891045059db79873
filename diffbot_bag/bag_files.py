"""Write the MCAP files and the metadata.yaml of one bag, split by size and duration."""

from __future__ import annotations

import contextlib
import os
import struct
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import MessageIndex, Schema
from mcap.writer import CompressionType, Writer

from diffbot_bag import metadata
from diffbot_bag.bag import HASH_KEY, QOS_KEY
from diffbot_bag.metadata import BagMetadata, FileInformation, Topic
from diffbot_bag.qos import dump_profiles
from diffbot_core.files import write_text

LIBRARY = "diffbot"
"""Name in the header of each file. These files number the channels in the order of the topics in metadata.yaml."""
Row = tuple[int, int, bytes, int, int]
"""Channel, log time [ns], data, publish time [ns], sequence number: the arguments of mcap's ``add_message``."""
_HEAD = struct.Struct("<BQHIQQ")
"""Opcode and length of a record, then channel, sequence number, log time and publish time of a message."""
_PREFIX = struct.calcsize("<BQ")
AttachmentFields = tuple[str, str, bytes]
"""Name, media type and data of an attachment."""


class FileLimits(NamedTuple):
    """Limits at which a file ends and the next one begins; 0: no limit."""

    max_size: int = 0
    """[bytes] size of a file; the chunk that reaches this size is the last chunk of the file"""
    max_duration: int = 0
    """[ns] between the first message of a file and the first message of the next file"""
    max_files: int = 0
    """number of files to keep; the oldest are deleted"""


class LatchedRows:
    """The last message of each publisher of a latched topic, which a late subscriber would receive.

    A message has a sequence number but does not name its publisher. A message replaces the kept message with the
    preceding sequence number, if exactly one has that number. Otherwise it is added, and the oldest messages beyond
    twice the number of publishers are dropped.
    """

    def __init__(self, publishers: int) -> None:
        """Start without messages."""
        self.publishers = publishers
        self.rows: list[Row] = []

    def keep(self, row: Row) -> None:
        """Add a received message."""
        if self.publishers <= 1:
            self.rows = [row]
            return
        before = [kept for kept in self.rows if kept[4] == row[4] - 1 and row[4] > 0]
        if len(before) == 1:
            self.rows.remove(before[0])
        self.rows.append(row)
        del self.rows[: -2 * self.publishers]


class BagFiles:
    """The files of one bag. Each file has all topics and attachments, so that it can be read alone.

    One thread at a time may use it. The methods raise OSError; after an error, only :meth:`abandon` may be called.
    """

    def __init__(
        self,
        folder: Path,
        compression: CompressionType,
        limits: FileLimits,
        custom_data: Callable[[], Mapping[str, str]],
    ) -> None:
        """Prepare to write into an existing folder; ``custom_data`` returns the notes for metadata.yaml."""
        self._folder, self._compression, self._limits, self._custom_data = folder, compression, limits, custom_data
        self._stream: BinaryIO | None = None
        self._writer: Any = None
        self._finished: list[tuple[FileInformation, Counter[int]]] = []
        self._counts = Counter[int]()
        """number of messages in the current file by channel"""
        self._first_time, self._span = 0, (0, 0)
        self._channels: list[tuple[Topic, Schema | None]] = []
        self._attachments: dict[str, AttachmentFields] = {}
        self._metadata_lists_all_topics = True
        self._number = -1
        self.path = folder
        """the newest file"""
        self.latched: dict[int, LatchedRows] = {}

    def begin(self) -> None:
        """Create the next file, with all topics and attachments added so far."""
        if self._limits.max_files:
            self._delete_oldest(self._limits.max_files - 1)
        self._number += 1
        self.path = self._folder / f"{self._folder.name}_{self._number}.mcap"
        self._stream = self.path.open("xb")
        # Each batch of messages becomes one chunk, so the writer must not end a chunk by itself.
        self._writer = Writer(self._stream, chunk_size=2**62, compression=self._compression)
        self._writer.start("ros2", LIBRARY)
        for topic, schema in self._channels:
            self._register(topic, schema)
        for attachment in self._attachments.values():
            self._attach(attachment)
        self._write_metadata(durable=False)

    def _delete_oldest(self, kept: int) -> None:
        surplus = self._finished[: max(len(self._finished) - kept, 0)]
        self._finished = self._finished[len(surplus) :]
        if surplus:
            # Write metadata.yaml first, so that it never names a missing file.
            self._write_metadata(durable=True)
        for file, _ in surplus:
            (self._folder / file.name).unlink(missing_ok=True)

    def add_channel(self, topic: Topic, schema: Schema | None) -> None:
        """Add a topic to the current file and all later files."""
        self._channels.append((topic, schema))
        self._metadata_lists_all_topics = False
        if self._stream is not None:
            self._register(topic, schema)

    def _register(self, topic: Topic, schema: Schema | None) -> None:
        number = self._writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
        notes = {QOS_KEY: dump_profiles(topic.qos), HASH_KEY: topic.type_hash}
        self._writer.register_channel(topic.name, topic.encoding, number, notes)

    def attach(self, attachment: AttachmentFields) -> None:
        """Add an attachment to the current file and all later files; it replaces an earlier one with its name."""
        self._attachments[attachment[0]] = attachment
        if self._stream is not None:
            self._attach(attachment)

    def _attach(self, attachment: AttachmentFields) -> None:
        now = time.time_ns()
        self._writer.add_attachment(now, now, *attachment)

    def write(self, rows: Sequence[Row]) -> None:
        """Write a batch of messages; begin a new file where a limit is reached."""
        while rows:
            if self._stream is None:
                self.begin()
            if not self._counts:
                self._first_time = rows[0][1]
                self._span = self._first_time, self._first_time
                # Repeat latched messages with the time of the first message: earlier times would lengthen the file.
                # Copy the values at once: the calling thread may add a topic meanwhile.
                repeated = [row for latched in list(self.latched.values()) for row in latched.rows]
                self._append([(row[0], self._first_time, *row[2:]) for row in repeated])
            count = len(rows)
            if self._limits.max_duration:
                end = self._first_time + self._limits.max_duration
                count = next((index for index, row in enumerate(rows) if row[1] >= end), count)
            self._append(rows[:count])
            for row in rows[:count]:
                if row[0] in self.latched:
                    self.latched[row[0]].keep(row)
            rows = rows[count:]
            if self._stream and (rows or 0 < self._limits.max_size <= self._stream.tell()):
                self.end()

    def _append(self, rows: Sequence[Row]) -> None:
        """Write rows as one chunk."""
        if not rows:
            return
        # Write metadata.yaml before a new topic's messages: a repair needs the list of topics if this chunk is damaged.
        if not self._metadata_lists_all_topics:
            self._write_metadata(durable=False)
        first, last = add_messages(self._writer, rows)
        self._writer.flush()
        self._span = min(self._span[0], first), max(self._span[1], last)
        self._counts.update([row[0] for row in rows])

    def sync(self) -> None:
        """Write the buffers of the file to the disk."""
        if self._stream is not None:
            self._stream.flush()
            os.fsync(self._stream.fileno())

    def end(self) -> None:
        """Finish the current file, if there is one, and write metadata.yaml."""
        if self._stream is not None:
            file = self._information()
            text = metadata.to_yaml(self._metadata([file], self._counts), root=False)
            self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
            self._writer.finish()
            self.sync()
            self._stream.close()
            self._stream = None
            self._finished.append((file, self._counts))
            self._counts = Counter()
        self._write_metadata(durable=True)

    def split(self) -> bool:
        """End the current file if it has messages; return True if it was ended."""
        has_messages = bool(self._counts)
        if has_messages:
            self.end()
        return has_messages

    def abandon(self) -> None:
        """Close the current file without finishing it, after an error."""
        if self._stream is not None:
            with contextlib.suppress(OSError):
                self._stream.close()

    def _information(self) -> FileInformation:
        start, end = self._span if self._counts else (0, 0)
        return FileInformation(self.path.name, start, end - start, self._counts.total())

    def _write_metadata(self, *, durable: bool) -> None:
        files, counts = [file for file, _ in self._finished], self._counts.copy()
        for _, finished_counts in self._finished:
            counts.update(finished_counts)
        if self._stream is not None:
            files.append(self._information())
        text = metadata.to_yaml(self._metadata(files, counts))
        write_text(self._folder / metadata.FILE_NAME, text, durable=durable, in_bag=True)
        self._metadata_lists_all_topics = True

    def _metadata(self, files: Sequence[FileInformation], counts: Counter[int]) -> BagMetadata:
        topics = (topic._replace(message_count=counts[n]) for n, (topic, _) in enumerate(self._channels, 1))
        distro = os.environ.get("ROS_DISTRO", "jazzy")
        return BagMetadata(tuple(files), tuple(topics), self._custom_data(), distro)


def add_messages(writer: Any, rows: Sequence[Row]) -> tuple[int, int]:
    """Add messages to the current chunk of an mcap Writer; return the smallest and the largest log time [ns].

    This writes the same bytes as ``Writer.add_message`` for each message, in a third of the time, which is needed at
    8 kHz. It uses private attributes of the Writer, because mcap does not have a public method for it.
    """
    chunk, statistics = writer._Writer__chunk_builder, writer._Writer__statistics
    parts: list[bytes] = []
    indices: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
    offset, pack, opcode, fixed = chunk.record_writer.count, _HEAD.pack, int(Opcode.MESSAGE), _HEAD.size - _PREFIX
    for channel, log_time, data, publish_time, sequence in rows:
        indices[channel].append((log_time, offset))
        parts += pack(opcode, fixed + len(data), channel, sequence, log_time, publish_time), data
        offset += _HEAD.size + len(data)
    chunk.record_writer.write(b"".join(parts))
    for channel, entries in indices.items():
        chunk.message_indices.setdefault(channel, MessageIndex(channel, [])).records.extend(entries)
        statistics.channel_message_counts[channel] += len(entries)
    times = [row[1] for row in rows]
    begin, end = min(times), max(times)
    chunk.message_start_time = min(chunk.message_start_time, begin) if chunk.num_messages else begin
    chunk.message_end_time = max(chunk.message_end_time, end)
    chunk.num_messages += len(rows)
    first = statistics.message_count == 0
    statistics.message_start_time = begin if first else min(statistics.message_start_time, begin)
    statistics.message_end_time = max(statistics.message_end_time, end)
    statistics.message_count += len(rows)
    return begin, end
