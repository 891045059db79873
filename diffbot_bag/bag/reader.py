"""Read rosbag2 MCAP bags: topics, raw messages in the order of log time, and decoded messages for reports."""

from __future__ import annotations

import contextlib
import heapq
import io
import operator
from collections.abc import Iterable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding

from diffbot_bag.bag import metadata
from diffbot_bag.bag.metadata import BagMetadata, Topic
from diffbot_bag.mcap.attachments import PARAMETERS, Parameters, load_parameters
from diffbot_bag.mcap.chunks import BagLimits
from diffbot_bag.mcap.file import McapFile
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import inside, shown

MAX_FILES = 1000
"""of one bag; all of them are open together"""
MAX_DECODED = 1024**2
"""[bytes] of a message that is decoded: each byte may become an object of a hundred and more"""


DECODED_RATIO = 32
"""Size of all decoded messages to the size of the bag, beyond 4 MAX_DECODED; odometry that is packed has 10."""


class RawMessage(NamedTuple):
    """A message as it was recorded; times in [ns]."""

    topic: str
    data: bytes
    log_time: int
    publish_time: int


class DecodedMessage(NamedTuple):
    """A message with its fields as attributes of ``content``; times in [ns]."""

    topic: str
    content: Any
    log_time: int
    publish_time: int


class BagReader:
    """An open bag: a folder of rosbag2 or one MCAP file. Close it, or use it in a ``with`` statement."""

    _file_type: type[McapFile] = McapFile

    def __init__(self, path: str | PathLike[str], limits: BagLimits | None = None) -> None:
        """Open the bag and read its index.

        Args:
            path: folder or file; nothing outside of it is read, whatever its metadata name.
            limits: how much each file may unpack to; default: those of BagLimits.

        Raises:
            DiffbotError: if it is missing, not a rosbag2 MCAP bag, damaged, empty, or beyond the limits.
        """
        self.path = Path(path)
        self.metadata: BagMetadata | None = None
        self._files: list[McapFile] = []
        try:
            self.path = self.path.expanduser()
            for file in self._file_paths():
                self._files.append(self._file_type(file, limits))
        except DiffbotError:
            self.close()
            raise
        except (OSError, RuntimeError) as error:  # a name that is too long; the home of an unknown user
            self.close()
            raise DiffbotError(f"no bag {shown(path)}: {getattr(error, 'strerror', None) or error}") from error

    def _file_paths(self) -> list[Path]:
        if "\0" in str(self.path) or not self.path.exists():
            raise DiffbotError(f"no bag {shown(self.path)}: no such file or folder")
        if not self.path.is_dir():
            return [self.path]
        if (self.path / metadata.FILE_NAME).exists():
            self.metadata = metadata.read(self.path)
            names = list(self.metadata.files)
        else:
            names = sorted(file.name for file in self.path.glob("*.mcap"))
        if not names:
            raise DiffbotError(f"no bag in {self.path}: neither {metadata.FILE_NAME} nor an MCAP file")
        found = [inside(self.path, name) for name in names[: MAX_FILES + 1]]
        if len(found) > MAX_FILES:
            raise DiffbotError(f"{self.path} has {len(names)} files: must be <= {MAX_FILES}")
        if len({file.resolve() for file in found}) < len(found):
            raise DiffbotError(f"{self.path / metadata.FILE_NAME} lists a file twice")
        return found

    def __enter__(self) -> BagReader:
        """Return the reader itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the files."""
        self.close()

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()

    @property
    def warning(self) -> str:
        """One line about a bag that was not finished, and is read up to there; empty for a complete one."""
        found = [f"{file.path.name} has {file.unfinished}" for file in self._files if file.unfinished]
        if self.path.is_dir() and self.metadata is None:
            found.append(f"{metadata.FILE_NAME} is missing")
        if not found:
            return ""
        return shown(f"{self.path} is unfinished: {'; '.join(found)} (`diffbot bag repair` writes a complete one)")

    @property
    def topics(self) -> dict[str, Topic]:
        """Topics of the bag by name, with type, offered QoS and number of messages."""
        found: dict[str, Topic] = {}
        for file in self._files:
            for topic in file.topics():
                known = found.get(topic.name)
                found[topic.name] = (
                    topic if known is None else known._replace(message_count=known.message_count + topic.message_count)
                )
        return found

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(file.message_count for file in self._files)

    @property
    def start(self) -> int:
        """Time [ns] of the first message; 0 for a bag without messages."""
        return min((file.span()[0] for file in self._files if file.message_count), default=0)

    @property
    def end(self) -> int:
        """Time [ns] of the last message; 0 for a bag without messages."""
        return max((file.span()[1] for file in self._files if file.message_count), default=0)

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

        Raises:
            DiffbotError: if a file turns out to be damaged.
        """
        for _, channel, message in self._records(topics, start, end, reverse):
            yield RawMessage(channel.topic, message.data, message.log_time, message.publish_time)

    def attachment(self, name: str) -> bytes | None:
        """Return the data of the newest attachment of a name, such as ``parameters.json``; None without one.

        Raises:
            DiffbotError: if it is larger than MAX_ATTACHMENT of the module ``attachments``, or damaged.
        """
        found = (file.attachment(name) for file in reversed(self._files))
        return next((data for data in found if data is not None), None)

    def node_parameters(self) -> Parameters:
        """Return the parameters of all nodes, as they were when recording began; empty if they were not recorded.

        Raises:
            DiffbotError: if the attachment is damaged.
        """
        return load_parameters(self.attachment(PARAMETERS), self.path)

    def rows(self, topics: Iterable[str]) -> Iterator[tuple[int, str, int, int, bytes]]:
        """Iterate over log time [ns], topic, sequence number, publish time [ns] and data; the fastest way.

        The order is that of :meth:`messages`, except among messages of the same log time.

        Raises:
            DiffbotError: if a file turns out to be damaged.
        """
        names = frozenset(topics)
        streams = [file.rows(names) for file in self._files]
        return streams[0] if len(streams) == 1 else heapq.merge(*streams, key=operator.itemgetter(0))

    @property
    def files(self) -> Sequence[McapFile]:
        """The files, in the order of metadata.yaml."""
        return self._files

    @property
    def definitions(self) -> dict[str, str]:
        """Message definition (the .msg text and those it needs) of each topic whose messages are CDR."""
        return {name: text for file in reversed(self._files) for name, text in file.definitions().items()}

    def last_before(self, time: int, topics: Iterable[str]) -> list[RawMessage]:
        """Return the last message before ``time`` [ns] of each of these topics that has one, in the order of log time.

        Raises:
            DiffbotError: if a file turns out to be damaged.
        """
        missing = set(topics)
        found = []
        for message in self.messages(tuple(missing), end=time - 1, reverse=True) if missing else ():
            if message.topic in missing:
                missing.remove(message.topic)
                found.append(message)
            if not missing:
                break
        return found[::-1]

    def decoded(
        self, topics: Iterable[str] | None = None, start: int | None = None, end: int | None = None
    ) -> Iterator[DecodedMessage]:
        """Iterate over decoded messages in the order of log time; arguments as for :meth:`messages`.

        Raises:
            DiffbotError: if a message cannot be decoded, one is larger than MAX_DECODED or all are larger than the bag
                allows, or the file is damaged.
        """
        # Loading them takes longer than many a command on a bag.
        from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415

        from diffbot_bag.bag.encoding import decode_numbers_message  # noqa: PLC0415

        decoders: dict[tuple[str, bytes], Any] = {}
        left = most = 4 * MAX_DECODED + DECODED_RATIO * sum(file.size for file in self._files)
        for schema, channel, message in self._records(topics, start, end, False):
            key = (schema.name, schema.data) if schema else ("", b"")
            if key not in decoders:
                # The factory caches decoders by schema id, which is unique only within a file.
                decoders[key] = _decoder(DecoderFactory(), channel, schema)
            if (size := len(message.data)) > MAX_DECODED:
                raise DiffbotError(
                    f"{self.path}: {shown(channel.topic)} at {message.log_time} ns has {size} bytes:"
                    f" must be <= {MAX_DECODED} to be decoded"
                )
            left -= size
            if left < 0:
                raise DiffbotError(f"{shown(self.path)}: messages to decode have more than {most} bytes")
            try:
                content = decode_numbers_message(key[0], message.data) or decoders[key](message.data)
            except Exception as error:  # of a decoder that was made of the bag's own definition
                raise DiffbotError(
                    f"{self.path}: cannot decode {shown(channel.topic)} at {message.log_time} ns"
                ) from error
            yield DecodedMessage(channel.topic, content, message.log_time, message.publish_time)

    def _records(
        self, topics: Iterable[str] | None, start: int | None, end: int | None, reverse: bool
    ) -> Iterator[tuple[Schema | None, Channel, Any]]:
        if start is not None and end is not None and start > end:
            return iter(())
        names = None if topics is None else tuple(topics)
        streams = [file.records(names, start, end, reverse) for file in self._files]
        if len(streams) == 1:
            return streams[0]
        return heapq.merge(*streams, key=lambda record: record[2].log_time, reverse=reverse)


def _decoder(factory: Any, channel: Channel, schema: Schema | None) -> Any:
    try:
        # The parser prints what it cannot parse.
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            decoder = factory.decoder_for(channel.message_encoding, schema)
    except Exception as error:  # the parser has exceptions of its own, and raises any other
        raise DiffbotError(f"{shown(channel.topic)}: its message definition cannot be parsed") from error
    if decoder is None or channel.message_encoding != MessageEncoding.CDR:
        raise DiffbotError(f"{shown(channel.topic)}: no message definition in the bag")
    return decoder
