"""One MCAP file: verified when opened, read in the order of log time; an unfinished one up to where it was cut off."""

from __future__ import annotations

import bisect
import contextlib
import errno
import heapq
import operator
import os
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

from mcap.exceptions import EndOfFile, McapError
from mcap.records import AttachmentIndex, Channel, ChunkIndex, Message, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from diffbot_bag.bag.metadata import Topic
from diffbot_bag.bag.qos import Qos, load_profiles
from diffbot_bag.mcap.attachments import MAX_ATTACHMENT, read_attachment
from diffbot_bag.mcap.chunks import MAX_RECORDS, BagLimits, Row, check_chunks, read_chunk
from diffbot_bag.mcap.format import DAMAGE, MAGIC, McapSummary, NoIndexError, check_time, read_summary
from diffbot_bag.mcap.unfinished import scan_messages, scan_unfinished
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import open_regular, shown

MAX_QOS_TEXT = 4 * 2**20
"""characters of QoS in all channels of a file"""
_LOG_TIME = operator.itemgetter(0)
"""of a row"""


class McapFile:
    """One MCAP file with its index, which is made by reading all of it if the file was not finished."""

    def __init__(self, path: Path, limits: BagLimits | None = None) -> None:
        """Open the file and read its index.

        Raises:
            DiffbotError: if it is missing, not an MCAP file, damaged, or unpacks to more than the limits.
        """
        self.path = path
        self.unfinished = ""
        """What is missing at the end of a file that was not finished; empty for a complete one."""
        self._limits = limits or BagLimits()
        self._stream = open_regular(path)
        try:
            self._size = os.fstat(self._stream.fileno()).st_size
            self._check_magic()
            with self._damage_as_error():
                summary = self._summary()
                check_chunks(summary.chunks, self._size, self._limits)
                check_time(summary.statistics.message_end_time)
        except DiffbotError:
            self._stream.close()
            raise
        self._end = summary.start
        self._schemas, self._channels = summary.schemas, summary.channels
        self._chunks, self._statistics = summary.chunks, summary.statistics
        self._attached = summary.attached

    def _check_magic(self) -> None:
        if self._size == 0:
            raise DiffbotError(f"{self.path} is an empty file")
        if self._stream.read(len(MAGIC)) != MAGIC:
            raise DiffbotError(f"{self.path} is not an MCAP file")

    def _summary(self) -> McapSummary:
        self._stream.seek(max(self._size - len(MAGIC), len(MAGIC)))
        if self._stream.read() == MAGIC:
            try:
                return read_summary(self._stream, self._size)
            except NoIndexError:
                pass
        summary, unread = scan_unfinished(self._stream, self._size, self._limits)
        self.unfinished = "no index" + (f", and the last {unread} bytes are an incomplete record" if unread else "")
        return summary

    @contextlib.contextmanager
    def _damage_as_error(self) -> Iterator[None]:
        try:
            yield
        except EndOfFile as error:
            raise self._damaged("a record without an end") from error
        except DiffbotError as error:
            raise DiffbotError(f"{shown(self.path)}: {error}") from error
        except McapError as error:
            raise self._damaged(shown(error)) from error
        except DAMAGE as error:
            raise self._damaged(type(error).__name__) from error
        except OSError as error:
            if error.errno == errno.EINVAL:
                raise self._damaged("an offset beyond the file") from error
            raise DiffbotError(f"cannot read {shown(self.path)}: {error.strerror}") from error

    def _damaged(self, what: str) -> DiffbotError:
        return DiffbotError(f"{self.path} is damaged ({what}): `diffbot bag repair` saves what is intact")

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    @property
    def size(self) -> int:
        """Size of the file [bytes]."""
        return self._size

    @property
    def chunks(self) -> Sequence[ChunkIndex]:
        """The index of the chunks, in the order of the summary."""
        return self._chunks

    def definitions(self) -> dict[str, str]:
        """Return the message definition of each topic that has one in the format of ROS's .msg files."""
        # One text per schema: of unknown origin, many channels may share a long one.
        texts = {
            number: schema.data.decode("utf-8", "replace")
            for number, schema in self._schemas.items()
            if schema.encoding == SchemaEncoding.ROS2
        }
        return {
            channel.topic: texts[channel.schema_id]
            for channel in self._channels.values()
            if channel.schema_id in texts and channel.message_encoding == MessageEncoding.CDR
        }

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
        texts = {number: channel.metadata.get("offered_qos_profiles", "") for number, channel in self._channels.items()}
        if (total := sum(map(len, texts.values()))) > MAX_QOS_TEXT:
            raise DiffbotError(f"{self.path}: QoS of {total} characters: must be <= {MAX_QOS_TEXT}")
        found = []
        for channel in self._channels.values():
            schema = self._schemas.get(channel.schema_id)
            found.append(
                Topic(
                    name=channel.topic,
                    type=schema.name if schema else "",
                    type_hash=channel.metadata.get("topic_type_hash", ""),
                    qos=self._profiles(channel.topic, texts[channel.id]),
                    message_count=counts.get(channel.id, 0),
                )
            )
        return found

    def _profiles(self, topic: str, text: str) -> tuple[Qos, ...]:
        try:
            return load_profiles(text)
        except DiffbotError as error:
            raise DiffbotError(f"{shown(self.path)}: {shown(topic)}: {error}") from error

    def attachment(self, name: str) -> bytes | None:
        """Return the data of the last attachment of a name; None without one.

        Raises:
            DiffbotError: if it is larger than MAX_ATTACHMENT or damaged.
        """
        found = [one for one in self._attached if isinstance(one, AttachmentIndex) and one.name == name]
        if not found:
            return None
        index = found[-1]
        if index.length > MAX_ATTACHMENT:
            raise DiffbotError(f"{self.path}: {shown(name)} has {index.length} bytes: must be <= {MAX_ATTACHMENT}")
        with self._damage_as_error():
            return read_attachment(self._stream, index)

    def records(
        self, topics: Collection[str] | None, start: int | None, end: int | None, reverse: bool
    ) -> Iterator[tuple[Schema | None, Channel, Message]]:
        """Iterate over schema, channel and message in the order of log time.

        Raises:
            DiffbotError: if the data turn out to be damaged.
        """
        earliest, latest = start or 0, 2**64 if end is None else end
        chosen = {number for number, channel in self._channels.items() if topics is None or channel.topic in topics}
        with self._damage_as_error():
            for message in self._messages(earliest, latest, reverse, chosen):
                channel = self._channels[message.channel_id]
                if earliest <= message.log_time <= latest and (topics is None or channel.topic in topics):
                    yield self._schemas[channel.schema_id] if channel.schema_id else None, channel, message

    def rows(self, topics: Collection[str]) -> Iterator[tuple[int, str, int, int, bytes]]:
        """Iterate over log time [ns], topic, sequence number, publish time [ns] and data, in the order of log time.

        It does what :meth:`records` does without an object per record, several times as fast.

        Raises:
            DiffbotError: if the data turn out to be damaged.
        """
        chosen = {number: one.topic for number, one in self._channels.items() if one.topic in topics}
        with self._damage_as_error():
            for log_time, number, sequence, publish_time, data in self._rows():
                if (topic := chosen.get(number)) is not None:
                    yield log_time, topic, sequence, publish_time, data

    def _rows(self) -> Iterator[Row]:
        if not self._chunks:
            for message in self._messages_without_chunks(False):
                yield message.log_time, message.channel_id, message.sequence, message.publish_time, message.data
            return
        chunks = sorted(self._chunks, key=lambda chunk: chunk.message_start_time)
        # Of a chunk, what is older than all that follow is complete; the rest waits, within check_chunks' bound.
        following = [*(chunk.message_start_time for chunk in chunks[1:]), 2**64]
        waiting: list[Row] = []
        for chunk, earliest in zip(chunks, following, strict=True):
            waiting += read_chunk(self._stream, chunk)
            _check_held(len(waiting))
            waiting.sort(key=_LOG_TIME)
            complete = bisect.bisect_left(waiting, earliest, key=_LOG_TIME)
            yield from waiting[:complete]
            del waiting[:complete]

    def _messages(self, earliest: int, latest: int, reverse: bool, channels: set[int]) -> Iterator[Message]:
        """Yield all messages of the chunks with one of the channels in a range of times [ns], in order of log time."""
        if not self._chunks:
            yield from self._messages_without_chunks(reverse)
            return
        sign = -1 if reverse else 1
        # A chunk is unpacked when its first message is due, before any message of that time.
        heap: list[tuple[int, int, int, int, Any]] = [
            (sign * (chunk.message_end_time if reverse else chunk.message_start_time), 0, number, 0, chunk)
            for number, chunk in enumerate(self._chunks)
            if chunk.message_start_time <= latest
            and chunk.message_end_time >= earliest
            # Without offsets nothing is known about the channels of a chunk.
            and not (chunk.message_index_offsets and channels.isdisjoint(chunk.message_index_offsets))
        ]
        heapq.heapify(heap)
        while heap:
            _, _, _, _, item = heapq.heappop(heap)
            if isinstance(item, Message):
                yield item
                continue
            offset = sign * item.chunk_start_offset
            for number, (log_time, channel, sequence, publish_time, data) in enumerate(read_chunk(self._stream, item)):
                message = Message(channel, log_time, data, publish_time, sequence)
                heapq.heappush(heap, (sign * log_time, 1, offset, sign * number, message))
            _check_held(len(heap))

    def _messages_without_chunks(self, reverse: bool) -> list[Message]:
        if self._statistics.message_count == 0:
            return []
        if self._size > self._limits.max_unpacked_size:
            raise DiffbotError(f"{self._size} bytes without chunks: must be <= {self._limits.max_unpacked_size}")
        messages = list(scan_messages(self._stream, self._size, self._limits, self._end))
        messages.sort(key=lambda message: message.log_time)
        check_time(messages[-1].log_time if messages else 0)
        return messages[::-1] if reverse else messages


def _check_held(count: int) -> None:
    if count > MAX_RECORDS:
        raise DiffbotError(f"{count} messages in chunks that overlap in time: must be <= {MAX_RECORDS}")
