"""Write a rosbag2 bag: a folder with one MCAP file, readable up to the last flush at any time, and metadata.yaml."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from diffbot_bag import metadata
from diffbot_bag.message_definitions import DefinitionNotFoundError, MessageDefinitions
from diffbot_bag.metadata import BagMetadata, Topic
from diffbot_bag.qos import Qos, dump_profiles
from diffbot_core.errors import DiffbotError

CHUNK_SIZE = 512 * 1024
"""[bytes] size of a chunk before compression; messages not yet in a chunk are lost if the process dies"""


class BagWriteError(DiffbotError):
    """The bag cannot be written; what was flushed before remains readable."""


class BagWriter:
    """Writer of one bag. A disk error raises BagWriteError and closes the bag."""

    def __init__(
        self,
        folder: Path,
        definitions: MessageDefinitions | None = None,
        *,
        chunk_size: int = CHUNK_SIZE,
        compress: bool = True,
    ) -> None:
        """Create the folder and the file ``<folder name>_0.mcap`` in it.

        Raises:
            BagWriteError: if the folder exists already or cannot be created.
        """
        self.folder = folder.expanduser().absolute()
        self._definitions = definitions or MessageDefinitions()
        self._topics: list[Topic] = []
        self._counts: list[int] = []
        self._schemas: dict[str, int] = {}
        self._start = 0
        self._end = 0
        self._flushed = 0
        self._stream = self._create()
        self._writer = Writer(
            self._stream,
            chunk_size=chunk_size,
            compression=CompressionType.ZSTD if compress else CompressionType.NONE,
        )
        try:
            self._writer.start(profile="ros2", library="diffbot")
            self._add_metadata_record({})
            # Detect a full disk now rather than when the first chunk is full.
            self.flush()
        except OSError as error:
            raise self._failure(error) from error

    @property
    def path(self) -> Path:
        """The MCAP file."""
        return self.folder / f"{self.folder.name}_0.mcap"

    @property
    def count(self) -> int:
        """Messages written so far."""
        return sum(self._counts)

    @property
    def closed(self) -> bool:
        """True after :meth:`close` or an error; nothing more can be written."""
        return self._stream.closed

    def _create(self) -> BinaryIO:
        try:
            self.folder.mkdir(parents=True)
            return self.path.open("wb")
        except FileExistsError as error:
            raise BagWriteError(f"{self.folder} exists already: choose another name for the bag") from error
        except OSError as error:
            raise BagWriteError(f"cannot create the bag {self.folder}: {error.strerror}") from error

    def add_topic(self, name: str, type_name: str, qos: Sequence[Qos] = (), type_hash: str = "") -> int:
        """Register a topic and return its channel for :meth:`write`.

        ``type_hash`` defaults to that of the installed type. A type without an installed definition gets an empty
        schema: its messages can be replayed, but not decoded from the bag alone.

        Raises:
            BagWriteError: if the disk is full.
        """
        topic = Topic(name, type_name, type_hash or self._installed_hash(type_name), tuple(qos))
        try:
            if type_name not in self._schemas:
                self._schemas[type_name] = self._register_schema(type_name)
            channel = self._writer.register_channel(
                topic=name,
                message_encoding=MessageEncoding.CDR,
                schema_id=self._schemas[type_name],
                metadata={
                    "offered_qos_profiles": dump_profiles(topic.qos),
                    "topic_type_hash": topic.type_hash,
                },
            )
        except OSError as error:
            raise self._failure(error) from error
        self._topics.append(topic)
        self._counts.append(0)
        return channel

    def _register_schema(self, type_name: str) -> int:
        try:
            text = self._definitions.schema_text(type_name)
        except DefinitionNotFoundError:
            return int(self._writer.register_schema(type_name, SchemaEncoding.SelfDescribing, b""))
        return int(self._writer.register_schema(type_name, SchemaEncoding.ROS2, text.encode()))

    def _installed_hash(self, type_name: str) -> str:
        try:
            return self._definitions.type_hash(type_name)
        except DefinitionNotFoundError:
            return ""

    def write(self, channel: int, data: bytes, log_time: int, publish_time: int, sequence: int = 0) -> None:
        """Append one message (CDR bytes); times in [ns].

        Raises:
            BagWriteError: if the disk is full; the bag is then closed.
        """
        try:
            self._writer.add_message(channel, log_time, data, publish_time, sequence)
        except OSError as error:
            raise self._failure(error) from error
        # Channels are numbered from 1 in the order of registration.
        self._counts[channel - 1] += 1
        if not self._start or log_time < self._start:
            self._start = log_time
        self._end = max(self._end, log_time)

    def flush(self) -> None:
        """Bring everything written so far to the disk, so that it survives a crash of the process or the machine.

        Raises:
            BagWriteError: if the disk is full; the bag is then closed.
        """
        try:
            self._writer.flush()  # type: ignore[no-untyped-call]
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise self._failure(error) from error
        self._flushed = self.count

    @property
    def unflushed(self) -> int:
        """Messages since the last flush; after an error, at most so many of those counted are not in the file."""
        return self.count - self._flushed

    def check_disk(self, min_free: int) -> None:
        """Check that the file is still where it was created, with ``min_free`` [bytes] of free space beside it.

        Raises:
            BagWriteError: if not. The bag stays open: what is left of the space is for its index.
        """
        try:
            found, space = os.stat(self.path), os.statvfs(self.folder)
        except OSError as error:
            raise BagWriteError(f"{self.path} has gone while it was written: {error.strerror}") from error
        if not os.path.samestat(found, os.fstat(self._stream.fileno())):
            raise BagWriteError(f"{self.path} was replaced while it was written")
        if (free := space.f_bavail * space.f_frsize) < min_free:
            raise BagWriteError(f"recording ends: {self.folder} has {free} bytes free: must be >= {min_free}")

    def close(self, custom_data: Mapping[str, str] | None = None) -> None:
        """Finish the file and write metadata.yaml; no effect on a closed bag.

        Raises:
            BagWriteError: if the disk is full.
        """
        if self.closed:
            return
        try:
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._add_metadata_record(custom_data or {})
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.flush()
            os.fsync(self._stream.fileno())
            self._stream.close()
            metadata.write(self.folder, self._metadata(custom_data or {}))
        except OSError as error:
            raise self._failure(error) from error

    def _add_metadata_record(self, custom_data: Mapping[str, str]) -> None:
        text = metadata.to_yaml(self._metadata(custom_data), root=False)
        self._writer.add_metadata("rosbag2", {"serialized_metadata": text})

    def _metadata(self, custom_data: Mapping[str, str]) -> BagMetadata:
        topics = (topic._replace(message_count=count) for topic, count in zip(self._topics, self._counts, strict=True))
        return BagMetadata(
            files=(self.path.name,),
            start=self._start,
            duration=self._end - self._start,
            message_count=self.count,
            topics=tuple(topics),
            custom_data=custom_data,
            ros_distro=os.environ.get("ROS_DISTRO", "jazzy"),
        )

    def _failure(self, error: OSError) -> BagWriteError:
        # Closing flushes the rest of the buffer, which fails for the same reason.
        with contextlib.suppress(OSError):
            self._stream.close()
        return BagWriteError(
            f"cannot write {self.path}: {error.strerror}; the bag ends after about {self.count} messages"
            " (it has no index; complete chunks can be read as a stream)"
        )


def is_unfinished(folder: Path) -> bool:
    """True if a folder has nothing in it but what a killed BagWriter leaves: its file, and parts of metadata.yaml."""
    for path in folder.iterdir():
        regular = path.is_file() and not path.is_symlink()
        if regular and path.name.startswith(f".{metadata.FILE_NAME}.") and path.suffix == ".part":
            continue
        if not regular or path.name != f"{folder.name}_0.mcap":
            return False
        with path.open("rb") as file:
            if file.read(len(MCAP0_MAGIC)) not in (b"", MCAP0_MAGIC):
                return False
    return True
