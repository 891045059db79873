"""Read topics, raw messages and decoded messages of one or several rosbag2 MCAP bags, in the order of log time.

If the recorder of a bag was killed, its last file has no index. That file is scanned up to its last whole record.
"""

from __future__ import annotations

import bisect
import functools
import heapq
import json
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.records import Channel, Schema

from diffbot_bag.index import MAX_TIME, Block, read_attachment, read_block, read_index
from diffbot_bag.metadata import FILE_NAME, BagMetadata, Topic, path_inside, without_losses
from diffbot_bag.metadata import read as read_metadata
from diffbot_bag.qos import INFINITE, load_profiles
from diffbot_core.errors import DiffbotError, InvalidValueError, shown
from diffbot_core.files import expanded, open_regular

PARAMETERS = "parameters.json"
"""Name of the attachment with the parameters of the nodes."""
CDR = "cdr"
"""MCAP's name of the encoding of ROS 2 messages."""
QOS_KEY, HASH_KEY = "offered_qos_profiles", "topic_type_hash"
"""rosbag2's keys in the metadata of an MCAP channel."""

Parameters = dict[str, dict[str, Any]]
"""Parameter values by node (full name) and by parameter name."""

_load_profiles = functools.lru_cache(maxsize=256)(load_profiles)


class RawMessage(NamedTuple):
    """A recorded message as bytes; times in [ns]."""

    topic: str
    data: bytes
    log_time: int
    publish_time: int
    sequence: int


class DecodedMessage(NamedTuple):
    """A recorded message with its fields as attributes of ``content``; times in [ns]."""

    topic: str
    content: Any
    log_time: int
    publish_time: int


class BagReader:
    """An open bag: a folder of rosbag2 or one MCAP file. Close it, or use it in a ``with`` statement.

    Every method that reads raises a DiffbotError if a file is damaged.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        """Read the index of each file of the bag.

        Args:
            path: folder or file. Files outside the folder are refused, even if its metadata name them.

        Raises:
            DiffbotError: if the bag is missing, not a rosbag2 MCAP bag, damaged or empty, or a topic has two types.
        """
        self.path = expanded(path)
        self.metadata: BagMetadata | None = None
        self._open: tuple[int, BinaryIO] | None = None
        try:
            self.files = self._find_files()
        except OSError as error:  # a name that is too long
            raise DiffbotError(f"no bag {shown(path)}: {error.strerror}") from error
        self._indexes = [read_index(file, number) for number, file in enumerate(self.files)]
        self._blocks = [block for index in self._indexes for block in index.blocks]
        self.topics: dict[str, Topic] = {}
        for index in self._indexes:
            for number, channel in index.channels.items():
                topic = topic_of(channel, index.schemas.get(channel.schema_id), index.counts.get(number, 0))
                self.topics[topic.name] = _with_count(self.topics.get(topic.name), topic, self.path)
        self.message_count = sum(topic.message_count for topic in self.topics.values())
        # [ns] log times of the first and last message; 0 for a bag without messages
        self.start = min((block.start for block in self._blocks), default=0)
        self.end = max((block.end for block in self._blocks), default=0)

    def _find_files(self) -> tuple[Path, ...]:
        """Return the files of the bag; read its metadata."""
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
        return tuple(path_inside(self.path, name) for name in dict.fromkeys(names))

    def __enter__(self) -> BagReader:
        """Return the reader itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the bag."""
        self.close()

    def close(self) -> None:
        """Close the bag."""
        if self._open is not None:
            self._open[1].close()
            self._open = None

    def _stream(self, number: int) -> BinaryIO:
        """Open a file of the bag and close the previous one, since a process may not open all files of a long bag."""
        if self._open is None or self._open[0] != number:
            self.close()
            self._open = number, open_regular(self.files[number])
        return self._open[1]

    @property
    def warning(self) -> str:
        """One line that describes why the bag is unfinished; empty for a complete bag."""
        files = zip(self.files, self._indexes, strict=True)
        reasons = [f"{file.name} has {index.unfinished}" for file, index in files if index.unfinished]
        if self.path.is_dir() and self.metadata is None:
            reasons.append(f"{FILE_NAME} is missing")
        if not reasons:
            return ""
        return shown(f"{self.path} is unfinished: {'; '.join(reasons)} (`diffbot bag repair` writes a complete bag)")

    @property
    def custom_data(self) -> Mapping[str, str]:
        """Notes of the recorder in metadata.yaml; without the numbers of lost messages if the bag is unfinished."""
        notes = self.metadata.custom_data if self.metadata else {}
        return without_losses(notes) if self.warning else notes

    @property
    def schemas(self) -> dict[str, Schema | None]:
        """MCAP schema by topic; None for a topic without one."""
        return {
            channel.topic: index.schemas.get(channel.schema_id)
            for index in reversed(self._indexes)
            for channel in index.channels.values()
        }

    @property
    def definitions(self) -> dict[str, str]:
        """Message definition by CDR topic: the .msg text, followed by the texts of nested types."""
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
        """Iterate over the messages as bytes, in the order of log time, then in the order of the files.

        Args:
            topics: names of the topics to read, or the name of one topic; None for all.
            start: [ns] earliest log time, included.
            end: [ns] latest log time, included.
            reverse: iterate from the latest message to the earliest.
        """
        names = (topics,) if isinstance(topics, str) else topics
        selected = self._topics_by_channel(self.topics if names is None else frozenset(names))
        earliest, latest = 0 if start is None else start, MAX_TIME if end is None else end

        def is_needed(block: Block) -> bool:
            overlaps = block.start <= latest and block.end >= earliest
            return overlaps and not (block.channels and block.channels.isdisjoint(selected[block.file]))

        sign = -1 if reverse else 1

        def first_time(block: Block) -> int:
            return -block.end if reverse else block.start

        blocks = sorted([block for block in self._blocks if is_needed(block)], key=first_time)
        # Each message follows its sort key: log time, file, position of the block and position in the block.
        waiting: list[tuple[int, int, int, int, RawMessage]] = []
        for block, following in zip_longest(blocks, blocks[1:]):
            topic_of_channel, file, offset = selected[block.file], sign * block.file, sign * block.offset
            for index, record in enumerate(read_block(self._stream(block.file), self.files[block.file], block)):
                topic = topic_of_channel.get(record.channel_id)
                if topic is not None and earliest <= record.log_time <= latest:
                    message = RawMessage(topic, record.data, record.log_time, record.publish_time, record.sequence)
                    waiting.append((sign * record.log_time, file, offset, sign * index, message))
            waiting.sort()
            # Blocks may overlap in time: a message that is not earlier than the next block waits for that block.
            count = bisect.bisect_left(waiting, (first_time(following),)) if following else len(waiting)
            yield from (row[-1] for row in waiting[:count])
            del waiting[:count]

    def _topics_by_channel(self, names: Container[str]) -> list[dict[int, str]]:
        """Return a map of channels to selected topics for each file."""
        return [
            {number: channel.topic for number, channel in index.channels.items() if channel.topic in names}
            for index in self._indexes
        ]

    def attachment(self, name: str) -> bytes | None:
        """Return the data of the newest attachment with a name, such as ``parameters.json``; None if there is none."""
        for number, index in reversed([*enumerate(self._indexes)]):
            if name in index.attachments:
                return read_attachment(self._stream(number), self.files[number], index.attachments[name])
        return None

    def node_parameters(self) -> Parameters:
        """Return the recorded parameters of all nodes; empty if they were not recorded.

        Raises:
            DiffbotError: if the attachment is not a map of nodes to their parameters.
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
        """Return the latched messages that a late subscriber would receive at ``time`` [ns], oldest first.

        Each latched publisher of a topic keeps one message until its lifespan is over. Messages do not name their
        publisher, so the newest messages of the topic are returned, one for each latched publisher.
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
        """Iterate over decoded messages in the order of log time. The arguments are the same as for :meth:`messages`.

        Raises:
            DiffbotError: if a topic is not encoded in CDR, a message cannot be decoded, or a file is damaged.
        """
        # Importing rosbags takes longer than many commands on a bag.
        from diffbot_bag.messages import decode  # noqa: PLC0415

        definitions = self.definitions
        for message in self.messages(topics, start, end):
            name, topic = message.topic, self.topics[message.topic]
            if topic.encoding != CDR:
                raise DiffbotError(f"{self.path}: {shown(name)} is encoded as {shown(topic.encoding)}: must be {CDR}")
            try:
                content = decode(topic.type, message.data, definitions.get(name))
            except DiffbotError as error:
                raise DiffbotError(f"{self.path}: {shown(name)} at {message.log_time} ns: {error}") from error
            yield DecodedMessage(name, content, message.log_time, message.publish_time)


def topic_of(channel: Channel, schema: Schema | None, message_count: int = 0) -> Topic:
    """Return the topic that an MCAP channel describes.

    Raises:
        DiffbotError: if the QoS in its metadata cannot be read.
    """
    try:
        qos = _load_profiles(channel.metadata.get(QOS_KEY, ""))
    except DiffbotError as error:
        raise DiffbotError(f"{shown(channel.topic)}: {error}") from error
    type_name, type_hash = schema.name if schema else "", channel.metadata.get(HASH_KEY, "")
    return Topic(channel.topic, type_name, type_hash, qos, message_count, channel.message_encoding)


def _with_count(known: Topic | None, topic: Topic, place: object) -> Topic:
    """Return ``known`` with the message count of ``topic`` added, or ``topic`` if ``known`` is None.

    Raises:
        DiffbotError: if type or encoding differ; the text begins with ``place``.
    """
    if known is None:
        return topic
    for first, second in ((known.type, topic.type), (known.encoding, topic.encoding)):
        if first != second:
            raise DiffbotError(f"{place}: {shown(topic.name)} is both {shown(first)} and {shown(second)}")
    return known._replace(message_count=known.message_count + topic.message_count)


class MergedBags:
    """Several open bags, read as one. Topics with the same name become one topic."""

    def __init__(self, paths: Sequence[Path]) -> None:
        """Open the bags.

        Args:
            paths: different folders or MCAP files.

        Raises:
            DiffbotError: if a bag cannot be read, is given twice, or has a topic with another type than an earlier bag.
        """
        self.paths = tuple(expanded(path) for path in paths)
        self.readers: list[BagReader] = []
        self.topics: dict[str, Topic] = {}
        known_files: set[Path] = set()
        for path in self.paths:
            reader = BagReader(path)
            # A file may be given by itself and with its folder.
            files = {file.resolve() for file in reader.files}
            if not files.isdisjoint(known_files):
                raise InvalidValueError("bags", str(path), sentence="this bag is given twice")
            known_files |= files
            self.readers.append(reader)
            for topic in reader.topics.values():
                known = self.topics.get(topic.name)
                merged = _with_count(known, topic, self)
                self.topics[topic.name] = merged._replace(qos=(known.qos if known else ()) + topic.qos)
        filled = [reader for reader in self.readers if reader.message_count]
        # [ns] log times of the first and last message; 0 without messages
        self.start = min((reader.start for reader in filled), default=0)
        self.end = max((reader.end for reader in filled), default=0)
        self.message_count = sum(reader.message_count for reader in filled)

    @property
    def warnings(self) -> list[str]:
        """One line for each unfinished bag."""
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
        """Iterate over the messages as bytes, in the order of log time; see :meth:`BagReader.messages`.

        If messages have equal log times, messages of an earlier bag in ``paths`` come first.
        """
        names = None if topics is None else tuple(topics)
        streams = [reader.messages(names, start, end) for reader in self.readers]
        return streams[0] if len(streams) == 1 else heapq.merge(*streams, key=lambda message: message.log_time)

    def latched_before(self, time: int, topics: Iterable[str]) -> list[RawMessage]:
        """Return the latched messages of all bags, oldest first; see :meth:`BagReader.latched_before`.

        The result has the latched messages of each bag: /tf_static of two robots is one topic with two last messages.
        """
        names = tuple(topics)
        found = [message for reader in self.readers for message in reader.latched_before(time, names)]
        return sorted(found, key=lambda message: message.log_time)
