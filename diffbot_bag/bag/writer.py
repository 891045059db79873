"""Write a rosbag2 bag: a folder with MCAP files, readable up to the last flush at any time, and metadata.yaml."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from os import PathLike
from pathlib import Path

from mcap.records import Channel
from mcap.well_known import MessageEncoding

from diffbot_bag.bag import metadata
from diffbot_bag.bag.message_definitions import MessageDefinitions
from diffbot_bag.bag.metadata import HASH_KEY, QOS_KEY, Topic
from diffbot_bag.bag.qos import Qos, dump_profiles
from diffbot_bag.mcap.format import ENTRY_SIZE, MAGIC, MAX_TIME, check_time
from diffbot_bag.mcap.whole_chunk import DEFAULT_COMPRESSION, Compression
from diffbot_bag.record.bag_files import NO_LIMITS, Attached, BagFiles, FileLimits
from diffbot_bag.record.chunk import CHANNEL_OVERHEAD, CHUNK_OVERHEAD, OVERHEAD, Row
from diffbot_bag.record.disk import Disk
from diffbot_bag.record.latched import LatchedMessages
from diffbot_bag.record.pending_messages import Held
from diffbot_bag.record.schemas import Schemas
from diffbot_core.errors import DiffbotError

CHUNK_SIZE = 512 * 1024
"""[bytes] size of a chunk before compression; messages not yet in a chunk are lost if the process dies"""
MAX_BACKLOG = 100 * 2**20
_NEVER = MAX_TIME + 1
"""[ns]"""


class BagWriteError(DiffbotError):
    """The bag cannot be written; what was flushed before remains readable."""


class BagWriter:
    """Writer of one bag. A disk error raises BagWriteError and closes the bag.

    Each file can be read by itself: it has all topics and attachments, and begins with the latched messages.
    """

    def __init__(
        self,
        folder: str | PathLike[str],
        definitions: MessageDefinitions | None = None,
        *,
        chunk_size: int = CHUNK_SIZE,
        compression: Compression = DEFAULT_COMPRESSION,
        limits: FileLimits = NO_LIMITS,
        disk: Disk | None = None,
    ) -> None:
        """Create the folder and the file ``<folder name>_0.mcap`` in it.

        Args:
            folder: of the bag; it must not exist.
            definitions: of message types; default: the installed ones.
            chunk_size: [bytes] before compression.
            compression: of the chunks.
            limits: of each file.
            disk: runs what waits for the disk, and a later call raises its errors; default: each call does.

        Raises:
            BagWriteError: if the folder exists already or cannot be created.
        """
        self.folder = Path(folder).expanduser().absolute()
        self._schemas, self._channels = Schemas(definitions or MessageDefinitions()), 0
        self._chunk_size, self._limits, self._disk = chunk_size, limits, disk or Disk()
        self._latched: dict[int, LatchedMessages] = {}
        self._rows: list[Row] = []
        self._size = self._sealed = self._flushed = self._number = self._given = 0
        self._is_begun = False
        self.describe: Callable[[], Mapping[str, str]] = dict
        """returns custom_data of metadata.yaml at the end of each file"""
        self.max_backlog = MAX_BACKLOG
        """[bytes] that may wait for the disk; beyond, :meth:`write` does"""
        self.closed = False
        """True after :meth:`close` or an error; nothing more can be written"""
        self._split_time = -1
        self._files = BagFiles(self.folder, compression, limits.max_files)
        self._begin()

    def _begin(self) -> None:
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError as error:
            raise BagWriteError(f"{self.folder} exists already: choose another name for the bag") from error
        except OSError as error:
            raise BagWriteError(f"cannot create the bag {self.folder}: {error.strerror}") from error
        self._run(self._files.begin)
        # Detect a full disk now rather than when the first chunk is full.
        self.flush()
        self._wait()

    @property
    def path(self) -> Path:
        """The present MCAP file, or the last one."""
        return self._files.present[0]

    def _run(self, job: Callable[[], None], size: int = 0) -> None:
        try:
            self._disk.run(job, size)
        except OSError as error:
            raise self._failure(error) from error

    def add_topic(self, name: str, type_name: str, qos: Sequence[Qos] = (), type_hash: str = "") -> int:
        """Register a topic and return its channel for :meth:`write`.

        ``type_hash`` defaults to that of the installed type. A type without an installed definition gets an empty
        schema: its messages can be replayed, but not decoded from the bag alone.

        Raises:
            BagWriteError: if the disk is full.
        """
        topic = Topic(name, type_name, type_hash or self._schemas.type_hash(type_name), tuple(qos))
        schema_id, added = self._schemas.add(type_name)
        self._channels += 1
        channel = Channel(
            id=self._channels,
            topic=name,
            message_encoding=MessageEncoding.CDR,
            metadata={QOS_KEY: dump_profiles(topic.qos), HASH_KEY: topic.type_hash},
            schema_id=schema_id,
        )
        self._run(partial(self._files.add_topic, topic, channel, added))
        if any(one.is_latched for one in topic.qos):
            self._latched[channel.id] = LatchedMessages(len(topic.qos))
        return channel.id

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add an attachment to this file and the next ones; one of the same name counts instead of earlier ones.

        Raises:
            BagWriteError: if the disk is full.
        """
        self._run(partial(self._files.attach, Attached(time.time_ns(), name, media_type, data)), len(data))

    def write(self, channel: int, data: bytes, log_time: int, publish_time: int, sequence: int = 0) -> None:
        """Append one message (CDR bytes); times in [ns].

        Raises:
            BagWriteError: if the disk is full; the bag is then closed.
            DiffbotError: if the log time is beyond MAX_TIME; the message is not written.
        """
        if log_time >= self._split_time:
            self._enter_file(log_time)
        if channel in self._latched:
            self._latched[channel].keep(Held(channel, data, log_time, publish_time, sequence))
        self._rows.append((channel, data, log_time, publish_time, sequence))
        self._size = size = self._size + len(data) + OVERHEAD
        if size > self._chunk_size:
            self._seal()
            self._split_large_file()

    def is_latched(self, channel: int) -> bool:
        """Return whether a publisher of the channel's topic is transient local."""
        return channel in self._latched

    def note_publishers(self, channel: int, count: int) -> None:
        """Set the number of publishers of a topic, which is the number of latched messages to keep."""
        if (latched := self._latched.get(channel)) is not None:
            latched.publishers = max(latched.publishers, count)

    def _enter_file(self, log_time: int) -> None:
        """Begin a file with its first message, at ``log_time`` [ns]: the one before has lasted long enough."""
        check_time(log_time)
        if self._is_begun:
            self.split()
        self._is_begun = True
        self._split_time = min(log_time + self._limits.max_duration, _NEVER) if self._limits.max_duration else _NEVER
        # With the time of the file's beginning: an earlier one would stretch the file.
        for channel, latched in self._latched.items():
            for message in latched:
                self._rows.append((channel, message.data, log_time, message.published, message.number))
                self._size += len(message.data) + OVERHEAD
                self._sealed -= 1

    def _seal(self) -> None:
        if rows := self._rows:
            size = self._size + ENTRY_SIZE * len(rows) + CHUNK_OVERHEAD + CHANNEL_OVERHEAD * self._channels
            self._rows, self._size = [], 0
            self._sealed += len(rows)
            self._given += size
            if self._disk.backlog > self.max_backlog:
                self._wait()
            self._run(partial(self._files.add_chunk, rows, size), size)

    def _split_large_file(self) -> None:
        if not self._limits.max_size:
            return
        file, size, unpacked = self._files.progress
        written = size - unpacked if file == self._number else self._files.head
        # What is not written yet is counted in full, as if it could not be compressed.
        if written + self._given >= self._limits.max_size:
            self.split()

    def split(self) -> bool:
        """End this file, if it has a message; the next message begins the next file.

        Returns:
            False if the file has no message.

        Raises:
            BagWriteError: if the disk is full; the bag is then closed.
        """
        if not self._is_begun:
            return False
        self._seal()
        self._run(partial(self._files.end, dict(self.describe())))
        self._is_begun, self._split_time, self._given = False, -1, 0
        self._number += 1
        return True

    def flush(self, sync: bool = True) -> None:
        """Bring everything written so far out of this process, and with ``sync`` to the disk.

        It then survives a crash of the process; with ``sync`` one of the machine, too. With a DiskThread this is done
        a moment later. A file that has reached its largest size ends: few messages may never fill a chunk.

        Raises:
            BagWriteError: if the disk is full; the bag is then closed.
        """
        self._seal()
        self._run(partial(self._flush, sync, self.count))
        self._split_large_file()

    def _flush(self, sync: bool, count: int) -> None:
        self._files.flush(sync)
        self._flushed = count

    @property
    def count(self) -> int:
        """Messages written so far, without latched ones that were repeated."""
        return self._sealed + len(self._rows)

    @property
    def unflushed(self) -> int:
        """Messages since the last flush; after an error, at most so many of those counted are not in the file."""
        return self.count - self._flushed

    def check_disk(self, min_free: int) -> None:
        """Check that the file is still where it was created, with ``min_free`` [bytes] of free space beside it.

        Raises:
            BagWriteError: if not. The bag stays open: what is left of the space is for its index.
        """
        if problem := self._files.problem(min_free):
            raise BagWriteError(problem)

    def close(self, custom_data: Mapping[str, str] | None = None) -> None:
        """Finish the file and write metadata.yaml; no effect on a closed bag.

        Raises:
            BagWriteError: if the disk is full.
        """
        if self.closed:
            return
        self._seal()
        self._run(partial(self._files.end, custom_data or {}))
        self._wait()
        self.closed = True
        self._disk.close()

    def _wait(self) -> None:
        try:
            self._disk.wait()
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> BagWriteError:
        if not self.closed:
            self.closed = True
            self._disk.close()
            self._files.abandon()
        return BagWriteError(
            f"cannot write {self.path}: {error.strerror}; the bag ends after about {self.count} messages"
            " (it has no index: `diffbot bag repair` makes one)"
        )


def is_unfinished(folder: Path) -> bool:
    """True if a folder has nothing in it but what a killed BagWriter leaves: its files, and parts of metadata.yaml."""
    own = re.compile(re.escape(folder.name) + r"_\d+\.mcap")
    for path in folder.iterdir():
        regular = path.is_file() and not path.is_symlink()
        if regular and path.name.startswith(f".{metadata.FILE_NAME}.") and path.suffix == ".part":
            continue
        if not regular or not own.fullmatch(path.name):
            return False
        with path.open("rb") as file:
            if file.read(len(MAGIC)) not in (b"", MAGIC):
                return False
    return True
