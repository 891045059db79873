"""One indexed MCAP file: verified when opened, read in the order of log time."""

from __future__ import annotations

import contextlib
import errno
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Schema, Statistics
from mcap.summary import Summary

from diffbot_bag.metadata import Topic
from diffbot_bag.qos import load_profiles
from diffbot_core.errors import DiffbotError

MAGIC = b"\x89MCAP0\r\n"
SUMMARY_START = struct.Struct("<QQ")
"""offsets of the summary and of its index; they precede the checksum and MAGIC at the end of the file"""
CRC = struct.Struct("<I")
DAMAGE = (
    McapError,
    struct.error,
    zstandard.ZstdError,
    ValueError,
    KeyError,
    IndexError,
    MemoryError,
    OverflowError,
)
"""Exceptions with which the mcap library reacts to corrupt data."""


class McapFile:
    """One MCAP file with its index."""

    def __init__(self, path: Path) -> None:
        """Open the file and read its index.

        Raises:
            DiffbotError: if it is missing, not an MCAP file, truncated or damaged.
        """
        self.path = path
        try:
            self._stream: BinaryIO = path.open("rb")
        except OSError as error:
            raise DiffbotError(f"cannot open {path}: {error.strerror}") from error
        try:
            self._check_ends()
            with self._damage_as_error():
                # The length fields of a corrupt record could request any amount of memory.
                self._reader = SeekingReader(self._stream, validate_crcs=True, record_size_limit=2**31)
                summary = self._reader.get_summary()
                if summary is not None:
                    self._check_summary()
            if summary is None or summary.statistics is None:
                raise DiffbotError(f"{path} has no index")
            self._summary: Summary = summary
            self._statistics: Statistics = summary.statistics
        except DiffbotError:
            self._stream.close()
            raise

    def _check_ends(self) -> None:
        size = self.path.stat().st_size
        if size == 0:
            raise DiffbotError(f"{self.path} is an empty file")
        if self._stream.read(len(MAGIC)) != MAGIC:
            raise DiffbotError(f"{self.path} is not an MCAP file")
        self._stream.seek(max(size - len(MAGIC), len(MAGIC)))
        if self._stream.read() != MAGIC:
            raise DiffbotError(f"{self.path} is truncated: its recording was cut off")
        self._stream.seek(0)

    @contextlib.contextmanager
    def _damage_as_error(self) -> Iterator[None]:
        try:
            yield
        except DAMAGE as error:
            raise self._damaged(type(error).__name__) from error
        except OSError as error:
            if error.errno == errno.EINVAL:
                raise self._damaged("an offset beyond the file") from error
            raise DiffbotError(f"cannot read {self.path}: {error.strerror}") from error

    def _damaged(self, what: str) -> DiffbotError:
        return DiffbotError(f"{self.path} is damaged ({what})")

    def _check_summary(self) -> None:
        """Verify the checksum of the summary, which mcap's reader ignores."""
        size = self._stream.seek(0, os.SEEK_END)
        end = size - len(MAGIC) - CRC.size
        self._stream.seek(end - SUMMARY_START.size)
        summary_start, _ = SUMMARY_START.unpack(self._stream.read(SUMMARY_START.size))
        (stored,) = CRC.unpack(self._stream.read(CRC.size))
        self._stream.seek(summary_start)
        if stored and stored != zlib.crc32(self._stream.read(end - summary_start)):
            raise self._damaged("checksum of the index")

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return self._statistics.message_count

    def span(self) -> tuple[int, int]:
        """Return the first and the last log time [ns]; zeros if there is no message."""
        return self._statistics.message_start_time, self._statistics.message_end_time

    def topics(self) -> list[Topic]:
        """Return the topics in the order of recording.

        Raises:
            DiffbotError: if the metadata of a channel is not what rosbag2 writes.
        """
        counts = self._statistics.channel_message_counts
        found = []
        for channel in self._summary.channels.values():
            schema = self._summary.schemas.get(channel.schema_id)
            found.append(
                Topic(
                    name=channel.topic,
                    type=schema.name if schema else "",
                    type_hash=channel.metadata.get("topic_type_hash", ""),
                    qos=load_profiles(channel.metadata.get("offered_qos_profiles", "")),
                    message_count=counts.get(channel.id, 0),
                )
            )
        return found

    def records(
        self, topics: Sequence[str] | None, start: int | None, end: int | None, reverse: bool
    ) -> Iterator[tuple[Schema | None, Channel, Any]]:
        """Iterate over schema, channel and message in the order of log time.

        Raises:
            DiffbotError: if the data turn out to be damaged.
        """
        with self._damage_as_error():
            yield from self._reader.iter_messages(topics, reverse=reverse, starting_at=start, ending_at=end)
