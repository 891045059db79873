"""Read rosbag2 MCAP bags: topics, raw messages in the order of log time, and decoded messages; several bags as one.

A bag whose recorder was killed is read up to its last whole record: instead of the missing index, the file is scanned.
"""

from __future__ import annotations

import bisect
import functools
import heapq
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.records import Channel, Schema

from diffbot_bag.index import MAX_TIME, Block, read_attachment, read_block, read_index
from diffbot_bag.metadata import FILE_NAME, BagMetadata, Topic, inside
from diffbot_bag.metadata import read as read_metadata
from diffbot_bag.qos import INFINITE, Qos, load_profiles
from diffbot_core.errors import DiffbotError, InvalidValueError, shown
from diffbot_core.files import open_regular

PARAMETERS = "parameters.json"
"""Name of the attachment with the parameters of the nodes."""
CDR = "cdr"
"""MCAP's name of the encoding of ROS 2 messages."""
QOS_KEY, HASH_KEY = "offered_qos_profiles", "topic_type_hash"
"""rosbag2's keys in the metadata of an MCAP channel."""

Parameters = dict[str, dict[str, Any]]
"""Value by name of the parameter, by full name of the node."""

_profiles_of = functools.lru_cache(maxsize=256)(load_profiles)


class RawMessage(NamedTuple):
    """A message as it was recorded; times in [ns]."""

    topic: str
    data: bytes
    log_time: int
    publish_time: int
    sequence: int


class DecodedMessage(NamedTuple):
    """A message with its fields as attributes of ``content``; times in [ns]."""

    topic: str
    content: Any
    log_time: int
    publish_time: int


class BagReader:
    """An open bag: a folder of rosbag2 or one MCAP file. Close it, or use it in a ``with`` statement.

    All methods that read raise a DiffbotError of one line if a file is damaged.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        """Read the index of each file of the bag.

        Args:
            path: folder or file; files outside of the folder are not read, whatever its metadata name.

        Raises:
            DiffbotError: if the bag is missing, not a rosbag2 MCAP bag, damaged or empty, or a topic has two types.
        """
        self.path = Path(path)
        self.metadata: BagMetadata | None = None
        self._open: tuple[int, BinaryIO] | None = None
        try:
            self.path = self.path.expanduser()
            self.files = self._file_paths()
        except (OSError, RuntimeError) as error:  # a name that is too long; the home of an unknown user
            raise DiffbotError(f"no bag {shown(path)}: {getattr(error, 'strerror', None) or error}") from error
        self._indexes = [read_index(file, number) for number, file in enumerate(self.files)]
        self._blocks = [block for index in self._indexes for block in index.blocks]
        self.topics: dict[str, Topic] = {}
        for index in self._indexes:
            for number, channel in index.channels.items():
                schema, count = index.schemas.get(channel.schema_id), index.counts.get(number, 0)
                _merge_topic(self.topics, topic_of(channel, schema, count), self.path)
        self.message_count = sum(topic.message_count for topic in self.topics.values())
        # [ns] log times of the first and last message; 0 for a bag without messages
        self.start = min((block.start for block in self._blocks), default=0)
        self.end = max((block.end for block in self._blocks), default=0)

    def _file_paths(self) -> tuple[Path, ...]:
        """Return the files of the bag, and read its metadata."""
        if "\0" in str(self.path) or not self.path.exists():
            raise DiffbotError(f"no bag {shown(self.path)}: no such file or folder")
        if not self.path.is_dir():
            return (self.path,)
        if (self.path / FILE_NAME).exists():
            self.metadata = read_metadata(self.path)
            names = [file.name for file in self.metadata.files]
        else:
            names = sorted(file.name for file in self.path.glob("*.mcap"))
        if not names:
            raise DiffbotError(f"no bag in {self.path}: neither {FILE_NAME} nor an MCAP file")
        return tuple(inside(self.path, name) for name in dict.fromkeys(names))

    def __enter__(self) -> BagReader:
        """Return the reader itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the bag."""
        self.close()

    def close(self) -> None:
        """Close the file that was read last; no other file is open."""
        if self._open is not None:
            self._open[1].close()
            self._open = None

    def _stream(self, number: int) -> BinaryIO:
        if self._open is None or self._open[0] != number:
            self.close()
            self._open = number, open_regular(self.files[number])
        return self._open[1]

    @property
    def warning(self) -> str:
        """One line about a bag that was not finished; empty for a complete one."""
        both = zip(self.files, self._indexes, strict=True)
        found = [f"{file.name} has {index.unfinished}" for file, index in both if index.unfinished]
        if self.path.is_dir() and self.metadata is None:
            found.append(f"{FILE_NAME} is missing")
        if not found:
            return ""
        return shown(f"{self.path} is unfinished: {'; '.join(found)} (`diffbot bag repair` writes a complete one)")

    @property
    def custom_data(self) -> Mapping[str, str]:
        """Notes of the recorder in metadata.yaml, such as its losses; empty without any."""
        return self.metadata.custom_data if self.metadata else {}

    @property
    def schemas(self) -> dict[str, Schema | None]:
        """MCAP's schema of each topic; None for a topic without one."""
        return {
            channel.topic: index.schemas.get(channel.schema_id)
            for index in reversed(self._indexes)
            for channel in index.channels.values()
        }

    @property
    def definitions(self) -> dict[str, str]:
        """Message definition (the .msg text and those it needs) of each CDR topic that has one."""
        return {
            name: schema.data.decode("utf-8", "replace")
            for name, schema in self.schemas.items()
            if schema is not None and schema.encoding == "ros2msg" and self.topics[name].encoding == CDR
        }

    def messages(
        self,
        topics: Iterable[str] | None = None,
        start: int | None = None,
        end: int | None = None,
        *,
        reverse: bool = False,
    ) -> Iterator[RawMessage]:
        """Iterate over the bytes in the order of log time.

        Args:
            topics: names to keep; None for all.
            start: [ns] earliest log time, itself included.
            end: [ns] latest log time, itself included.
            reverse: latest first.
        """
        names = None if topics is None else frozenset(topics)
        earliest, latest = 0 if start is None else start, MAX_TIME if end is None else end
        chosen = [
            {number: one.topic for number, one in index.channels.items() if names is None or one.topic in names}
            for index in self._indexes
        ]

        def is_needed(block: Block) -> bool:
            is_within = block.start <= latest and block.end >= earliest
            return is_within and not (block.channels and block.channels.isdisjoint(chosen[block.file]))

        sign = -1 if reverse else 1

        def begin(block: Block) -> int:
            return -block.end if reverse else block.start

        def due(message: RawMessage) -> int:
            return sign * message.log_time

        blocks = sorted([one for one in self._blocks if is_needed(one)][::sign], key=begin)
        waiting: list[RawMessage] = []
        for block, following in zip_longest(blocks, blocks[1:]):
            topic_of_channel = chosen[block.file]
            found = [
                RawMessage(topic, one.data, one.log_time, one.publish_time, one.sequence)
                for one in read_block(self._stream(block.file), self.files[block.file], block)
                if (topic := topic_of_channel.get(one.channel_id)) is not None and earliest <= one.log_time <= latest
            ]
            waiting += found[::sign]
            waiting.sort(key=due)
            # A message that is older than all blocks that follow is complete; the rest waits.
            complete = bisect.bisect_left(waiting, begin(following), key=due) if following else len(waiting)
            yield from waiting[:complete]
            del waiting[:complete]

    def attachment(self, name: str) -> bytes | None:
        """Return the data of the newest attachment of a name, such as ``parameters.json``; None without one.

        Raises:
            DiffbotError: if the file is damaged.
        """
        for number, index in reversed([*enumerate(self._indexes)]):
            if name in index.attachments:
                return read_attachment(self._stream(number), self.files[number], index.attachments[name])
        return None

    def node_parameters(self) -> Parameters:
        """Return the parameters of all nodes, as they were when recording began; empty if they were not recorded.

        Raises:
            DiffbotError: if the attachment is not what the recorder writes.
        """
        data = self.attachment(PARAMETERS)
        if data is None:
            return {}
        try:
            content = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise DiffbotError(f"{shown(self.path)}: {PARAMETERS} is not JSON") from error
        if not isinstance(content, dict) or not all(isinstance(values, dict) for values in content.values()):
            raise DiffbotError(f"{shown(self.path)}: {PARAMETERS} is not a map of nodes to their parameters")
        return content

    def latched_before(self, time: int, topics: Iterable[str]) -> list[RawMessage]:
        """Return the messages that a late subscriber of latched topics would receive at ``time`` [ns], oldest first.

        A message does not name its publisher, so one message is returned for each latched publisher of a topic, unless
        its lifespan is over.
        """
        known = [self.topics[name] for name in topics if name in self.topics]
        offers = {topic.name: [qos for qos in topic.qos if qos.is_latched] for topic in known}
        missing = {name: max(1, len(latched)) for name, latched in offers.items()}
        found: list[RawMessage] = []
        for message in self.messages(offers, end=time - 1, reverse=True) if offers else ():
            if missing[message.topic]:
                missing[message.topic] -= 1
                if time - message.log_time <= max((qos.lifespan for qos in offers[message.topic]), default=INFINITE):
                    found.append(message)
            if not any(missing.values()):
                break
        return found[::-1]

    def decoded(
        self, topics: Iterable[str] | None = None, start: int | None = None, end: int | None = None
    ) -> Iterator[DecodedMessage]:
        """Iterate over decoded messages in the order of log time; arguments as for :meth:`messages`.

        Raises:
            DiffbotError: if a topic is not encoded in CDR, a message cannot be decoded, or a file is damaged.
        """
        # rosbags takes longer to load than many a command on a bag.
        from diffbot_bag.messages import decode  # noqa: PLC0415

        definitions = self.definitions
        for topic, data, log_time, publish_time, _ in self.messages(topics, start, end):
            known = self.topics[topic]
            if known.encoding != CDR:
                raise DiffbotError(f"{self.path}: {shown(topic)} is encoded as {shown(known.encoding)}: must be {CDR}")
            try:
                content = decode(known.type, data, definitions.get(topic))
            except DiffbotError as error:
                raise DiffbotError(f"{self.path}: {shown(topic)} at {log_time} ns: {error}") from error
            yield DecodedMessage(topic, content, log_time, publish_time)


def topic_of(channel: Channel, schema: Schema | None, message_count: int = 0) -> Topic:
    """Return the topic that an MCAP channel describes.

    Raises:
        DiffbotError: if its QoS cannot be read.
    """
    try:
        qos = _profiles_of(channel.metadata.get(QOS_KEY, ""))
    except DiffbotError as error:
        raise DiffbotError(f"{shown(channel.topic)}: {error}") from error
    type_name, type_hash = schema.name if schema else "", channel.metadata.get(HASH_KEY, "")
    return Topic(channel.topic, type_name, type_hash, qos, message_count, channel.message_encoding)


def _merge_topic(merged: dict[str, Topic], topic: Topic, place: object, more_qos: tuple[Qos, ...] = ()) -> None:
    """Add a topic by name, or its count and ``more_qos`` to the topic of that name.

    Raises:
        DiffbotError: if the topic has two types or two encodings; ``place`` names the bags.
    """
    known = merged.setdefault(topic.name, topic._replace(message_count=0))
    for first, second in ((known.type, topic.type), (known.encoding, topic.encoding)):
        if first != second:
            raise DiffbotError(f"{place}: {shown(topic.name)} is both {shown(first)} and {shown(second)}")
    count = known.message_count + topic.message_count
    merged[topic.name] = known._replace(qos=known.qos + more_qos, message_count=count)


class MergedBags:
    """Several open bags, read as one. Topics of equal name are one topic. Errors are those of BagReader."""

    def __init__(self, paths: Sequence[Path]) -> None:
        """Open the bags.

        Args:
            paths: folders or MCAP files, each once.

        Raises:
            DiffbotError: if a bag cannot be read, is given twice, or has a topic of another type than an earlier bag.
        """
        self.paths = tuple(path.expanduser() for path in paths)
        self.readers: list[BagReader] = []
        self.topics: dict[str, Topic] = {}
        for path in self.paths:
            if any(reader.path.exists() and path.exists() and reader.path.samefile(path) for reader in self.readers):
                raise InvalidValueError("bags", str(path), sentence="this bag is given twice")
            self.readers.append(BagReader(path))
            for topic in self.readers[-1].topics.values():
                _merge_topic(self.topics, topic, self, topic.qos if topic.name in self.topics else ())
        filled = [reader for reader in self.readers if reader.message_count]
        # [ns] log times of the first and last message; 0 without messages
        self.start = min((reader.start for reader in filled), default=0)
        self.end = max((reader.end for reader in filled), default=0)
        self.message_count = sum(reader.message_count for reader in filled)

    @property
    def warnings(self) -> list[str]:
        """One line about each bag that was not finished."""
        return [reader.warning for reader in self.readers if reader.warning]

    def __str__(self) -> str:
        """Return the paths, separated by blanks."""
        return " ".join(map(str, self.paths))

    def close(self) -> None:
        """Close the bags."""
        for reader in self.readers:
            reader.close()

    def messages(
        self, topics: Iterable[str] | None = None, start: int | None = None, end: int | None = None
    ) -> Iterator[RawMessage]:
        """Iterate over the bytes in the order of log time; arguments as for :meth:`BagReader.messages`.

        Of messages with equal times, those of the bag given first come first.
        """
        names = None if topics is None else tuple(topics)
        streams = [reader.messages(names, start, end) for reader in self.readers]
        return streams[0] if len(streams) == 1 else heapq.merge(*streams, key=lambda message: message.log_time)

    def latched_before(self, time: int, topics: Iterable[str]) -> list[RawMessage]:
        """Return the messages that a late subscriber would receive of each bag; see :meth:`BagReader.latched_before`.

        Those of each bag, since /tf_static of two robots is one topic with two last messages.
        """
        names = tuple(topics)
        found = [message for reader in self.readers for message in reader.latched_before(time, names)]
        return sorted(found, key=lambda message: message.log_time)
