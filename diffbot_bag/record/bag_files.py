"""The files of one bag, written one after the other, and its metadata.yaml; all calls may come from another thread."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from mcap.records import Channel, Schema

from diffbot_bag.bag import metadata
from diffbot_bag.bag.file_lock import take_lock
from diffbot_bag.bag.metadata import RECORD_NAME, BagMetadata, FileInformation, Topic
from diffbot_bag.mcap.output import McapOutput
from diffbot_bag.mcap.whole_chunk import ChunkPacker, Compression
from diffbot_bag.record.chunk import Row, records


class FileLimits(NamedTuple):
    """When a file ends and the next one begins; 0: no limit."""

    max_size: int = 0
    """[bytes] of a file; the chunk that reaches it is its last one."""
    max_duration: int = 0
    """[ns] between the first message of a file and those that still belong to it."""
    max_files: int = 0
    """Files that are kept; the oldest are deleted."""


NO_LIMITS = FileLimits()


class Attached(NamedTuple):
    """An attachment; time in [ns]."""

    time: int
    name: str
    media_type: str
    data: bytes


class Progress(NamedTuple):
    """How far the file that is being written has got."""

    file: int
    """Number of the file, from 0."""
    size: int
    """[bytes] of it."""
    unpacked: int
    """[bytes] that its chunks would take without compression."""


class _Finished(NamedTuple):
    file: FileInformation
    counts: Mapping[int, int]
    """Messages by channel."""


class BagFiles:
    """Writes files that can each be read alone: every one has all topics and attachments of the bag.

    Its methods raise OSError, after which only :meth:`abandon` may be called.
    """

    def __init__(self, folder: Path, compression: Compression, max_files: int = 0) -> None:
        """Write into ``folder``; of more than ``max_files`` (0: no limit) the oldest are deleted."""
        self._folder, self._packer, self._max_files = folder, ChunkPacker(compression), max_files
        self._writer: McapOutput | None = None
        self._number = -1
        self._finished: list[_Finished] = []
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._topics: list[Topic] = []
        self._attachments: dict[str, Attached] = {}
        self._custom_data: Mapping[str, str] = {}
        self._unpacked = 0
        self.head = 0
        """[bytes] of the newest file before its first chunk"""
        self.progress = Progress(0, 0, 0)
        self.present: tuple[Path, os.stat_result | None] = (self._path(0), None)
        """the newest file and what it was when it was created"""

    def _path(self, number: int) -> Path:
        return self._folder / f"{self._folder.name}_{number}.mcap"

    def begin(self) -> None:
        """Create the next file, with what every file begins with; no effect if one is being written."""
        if self._writer is not None:
            return
        if self._max_files:
            self._delete_oldest(self._max_files - 1)
        self._number += 1
        self._unpacked = 0
        path = self._path(self._number)
        self._writer = writer = McapOutput(path.open("xb"))
        # Until the file is closed: nobody replaces it by what it holds so far.
        take_lock(writer.fileno)
        self.present = path, os.fstat(writer.fileno)
        for schema in self._schemas:
            writer.add_schema(schema)
        for channel in self._channels:
            writer.add_channel(channel)
        for attachment in self._attachments.values():
            writer.add_attachment(*attachment)
        writer.add_metadata(RECORD_NAME, self._record(_Finished(FileInformation(path.name), {})))
        self.head = writer.size
        self._note_progress()

    def _delete_oldest(self, kept: int) -> None:
        gone, self._finished = self._finished[: len(self._finished) - kept], self._finished[-kept:] if kept else []
        if gone and self._finished:
            metadata.write(self._folder, self._metadata(self._finished))
        elif gone:
            (self._folder / metadata.FILE_NAME).unlink(missing_ok=True)
        # After the metadata, which never names a file that is not there.
        for one in gone:
            (self._folder / one.file.name).unlink(missing_ok=True)

    def add_topic(self, topic: Topic, channel: Channel, schema: Schema | None) -> None:
        """Add a topic to this file and the next ones; ``schema``: None if another topic has it, too."""
        if schema is not None:
            self._schemas.append(schema)
            if self._writer is not None:
                self._writer.add_schema(schema)
        self._topics.append(topic)
        self._channels.append(channel)
        if self._writer is not None:
            self._writer.add_channel(channel)

    def attach(self, attachment: Attached) -> None:
        """Add an attachment to this file and the next ones, in place of an earlier one of its name."""
        self._attachments[attachment.name] = attachment
        if self._writer is not None:
            self._writer.add_attachment(*attachment)

    def add_chunk(self, rows: Sequence[Row], size: int) -> None:
        """Write a chunk of messages to this file; ``size`` [bytes] is what they take in a file without compression."""
        self.begin()
        if self._writer is not None:
            self._writer.add_chunk(self._packer.pack(*records(rows)))
            self._unpacked += size
            self._note_progress()

    def _note_progress(self) -> None:
        if self._writer is not None:
            self.progress = Progress(self._number, self._writer.size, self._unpacked)

    def flush(self, sync: bool) -> None:
        """See :meth:`McapOutput.flush`; no effect between two files."""
        if self._writer is not None:
            self._writer.flush(sync)

    def end(self, custom_data: Mapping[str, str]) -> None:
        """Finish this file and write metadata.yaml; without one, write metadata.yaml alone."""
        self._custom_data = custom_data
        if (writer := self._writer) is not None:
            file = FileInformation(writer.path.name, writer.start, writer.end - writer.start, writer.message_count)
            done = _Finished(file, writer.counts)
            writer.add_metadata(RECORD_NAME, self._record(done))
            writer.finish()
            self._writer = None
            self._finished.append(done)
        metadata.write(self._folder, self._metadata(self._finished))

    def problem(self, min_free: int) -> str:
        """Return why recording must end: the newest file is gone, or less than ``min_free`` [bytes] are free."""
        path, created = self.present
        try:
            found, space = os.stat(path), os.statvfs(self._folder)
        except OSError as error:
            return f"{path} has gone while it was written: {error.strerror}"
        if created is not None and not os.path.samestat(found, created):
            return f"{path} was replaced while it was written"
        if (free := space.f_bavail * space.f_frsize) < min_free:
            return f"recording ends: {self._folder} has {free} bytes free: must be >= {min_free}"
        return ""

    def abandon(self) -> None:
        """Leave the present file as it is, after an error."""
        if self._writer is not None:
            self._writer.abandon()

    def _record(self, file: _Finished) -> dict[str, str]:
        return metadata.to_record(self._metadata([file]))

    def _metadata(self, files: list[_Finished]) -> BagMetadata:
        counts = Counter[int]()
        for one in files:
            counts.update(one.counts)
        return metadata.of_files(
            [one.file for one in files],
            topics=tuple(
                topic._replace(message_count=counts[channel.id])
                for topic, channel in zip(self._topics, self._channels, strict=True)
            ),
            custom_data=self._custom_data,
            ros_distro=os.environ.get("ROS_DISTRO", "jazzy"),
        )
