"""Write a rosbag2 bag: a folder with MCAP files and metadata.yaml, readable up to the last flush at any time.

The calling thread only collects messages. A worker thread writes each batch as one compressed chunk and waits for the
disk, so that a slow disk does not delay the receiving of messages.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from os import PathLike
from pathlib import Path

from mcap.records import Schema
from mcap.well_known import SchemaEncoding
from mcap.writer import CompressionType

from diffbot_bag import definitions
from diffbot_bag.bag import CDR
from diffbot_bag.bag_files import BagFiles, FileLimits, LatchedRows, Row
from diffbot_bag.definitions import DefinitionNotFoundError, schema_text
from diffbot_bag.index import MAX_TIME
from diffbot_bag.metadata import Topic
from diffbot_bag.qos import Qos
from diffbot_core.errors import DiffbotError
from diffbot_core.files import expanded

CHUNK_SIZE = 512 * 1024
"""[bytes] size of a chunk before compression; messages that are not in a chunk yet are lost if the process dies"""
MAX_BACKLOG = 100 * 2**20
"""[bytes] largest amount of messages that wait for the disk"""
_OVERHEAD = 31
"""[bytes] size of a message in a chunk without its data"""


class BagWriteError(DiffbotError):
    """The bag cannot be written. Messages that were flushed before remain readable."""


class BagWriter:
    """Writer of one bag.

    An error of the worker thread, such as a full disk, closes the bag and is raised as BagWriteError by the same call
    or a later one. Each file begins with the latched messages of the files before it.
    """

    def __init__(
        self,
        folder: str | PathLike[str],
        *,
        chunk_size: int = CHUNK_SIZE,
        compression: str = "zstd",
        limits: FileLimits | None = None,
        max_backlog: int = MAX_BACKLOG,
    ) -> None:
        """Create the folder and the file ``<folder name>_0.mcap`` in it.

        Args:
            folder: folder of the bag; it must not exist.
            chunk_size: [bytes] size of a chunk before compression.
            compression: zstd, lz4 or none.
            limits: limits of each file; None: no limits.
            max_backlog: [bytes] If more messages wait for the disk, :meth:`write` waits.

        Raises:
            DiffbotError: if the folder already exists or cannot be created.
        """
        self.folder = expanded(folder).absolute()
        self._chunk_size, self._max_backlog = chunk_size, max_backlog
        self._rows: list[Row] = []
        self._rows_size = self._channels = self._flushed = self._bytes_submitted = self._bytes_done = 0
        self.count = 0
        """messages written so far, without repeated latched messages"""
        self.custom_data: Mapping[str, str] = {}
        """notes for metadata.yaml; assign a new mapping to change them, since the worker thread reads it"""
        self.closed = False
        """True after :meth:`close` or an error"""
        kind = CompressionType[compression.upper()]
        self._files = BagFiles(self.folder, kind, limits or FileLimits(), lambda: self.custom_data)
        self._error: BaseException | None = None
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError as error:
            raise BagWriteError(f"{self.folder} already exists: choose another name for the bag") from error
        except OSError as error:
            raise BagWriteError(f"cannot create the bag {self.folder}: {error.strerror}") from error
        self._worker = ThreadPoolExecutor(1, "bag")
        # Detect a full disk now, not when the first chunk is full.
        self._submit(self._files.begin)
        self._wait_for(self._files.sync)

    @property
    def path(self) -> Path:
        """The newest MCAP file."""
        return self._files.path

    def _submit(self, job: Callable[[], object], size: int = 0) -> Future[object]:
        """Submit a job that writes ``size`` [bytes] to the worker; raise the error of an earlier job."""
        self._raise_failure()
        self._bytes_submitted += size
        return self._worker.submit(self._execute, job, size)

    def _execute(self, job: Callable[[], object], size: int) -> object:
        try:
            # After an error the file has a gap, so later jobs must not write.
            return job() if self._error is None else None
        except BaseException as error:  # raised by _raise_failure in the calling thread
            self._error = error
            return None
        finally:
            self._bytes_done += size

    def _wait_for(self, job: Callable[[], object]) -> object:
        result = self._submit(job).result()
        self._raise_failure()
        return result

    def _raise_failure(self) -> None:
        error = self._error
        if error is None:
            return
        if not self.closed:
            self.closed = True
            self._worker.shutdown()
            self._files.abandon()
        reason = getattr(error, "strerror", None) or f"{type(error).__name__} {error}".rstrip()
        raise BagWriteError(
            f"cannot write {self.path}: {reason}; the bag ends after about {self.count} messages"
            " (it does not have an index: `diffbot bag repair` adds one)"
        ) from error

    def add_topic(
        self,
        name: str,
        type_name: str,
        qos: Sequence[Qos] = (),
        type_hash: str = "",
        encoding: str = CDR,
        schema: Schema | None = None,
    ) -> int:
        """Register a topic and return its channel for :meth:`write`.

        Args:
            name: name of the topic.
            type_name: ``pkg/msg/Type``, or the name of the schema of another encoding.
            qos: QoS that each publisher offers.
            type_hash: hash of the type; by default the hash of the installed type.
            encoding: MCAP's name of the message encoding.
            schema: schema of the messages; its id is ignored. By default it is the installed definition of the type.
                If the type is not installed, the schema is empty: the messages can be replayed, but not decoded.
        """
        if encoding == CDR:
            known_schema, known_hash = _installed(type_name)
            schema, type_hash = schema or known_schema, type_hash or known_hash
        topic = Topic(name, type_name, type_hash, tuple(qos), 0, encoding)
        self._channels += 1
        if any(offer.is_latched for offer in topic.qos):
            self._files.latched[self._channels] = LatchedRows(len(topic.qos))
        self._submit(partial(self._files.add_channel, topic, schema))
        return self._channels

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add an attachment to the current file and all later files; it replaces an earlier one with its name."""
        self._submit(partial(self._files.attach, (name, media_type, data)))

    def write(self, channel: int, data: bytes, log_time: int, publish_time: int, sequence: int = 0) -> None:
        """Append one message; times in [ns].

        Raises:
            DiffbotError: if a time is not in 0..MAX_TIME; the message is not written.
        """
        if not (0 <= log_time <= MAX_TIME and 0 <= publish_time <= MAX_TIME):
            raise DiffbotError(f"log time {log_time}, publish time {publish_time}: must be in 0..{MAX_TIME}")
        self._rows.append((channel, log_time, data, publish_time, sequence & 0xFFFFFFFF))
        self.count += 1
        self._rows_size += len(data) + _OVERHEAD
        if self._rows_size > self._chunk_size:
            self._submit_rows()

    def _submit_rows(self) -> None:
        if not self._rows:
            return
        rows, size = self._rows, self._rows_size
        self._rows, self._rows_size = [], 0
        self._submit(partial(self._files.write, rows), size)
        if self._bytes_submitted - self._bytes_done > self._max_backlog:
            self._wait_for(lambda: None)

    def is_latched(self, channel: int) -> bool:
        """Return True if a publisher of the channel's topic is transient local."""
        return channel in self._files.latched

    def note_publishers(self, channel: int, count: int) -> None:
        """Increase the number of publishers of a latched topic, which determines how many of its messages are kept."""
        if (latched := self._files.latched.get(channel)) is not None:
            latched.publishers = max(latched.publishers, count)

    def split(self) -> bool:
        """End the current file; the next message begins a new one. Return False if the file does not have messages."""
        self._submit_rows()
        return bool(self._wait_for(self._files.split))

    def flush(self) -> None:
        """Start to write all messages so far to the disk, where they survive a crash of the machine."""
        self._submit_rows()
        count = self.count

        def flush() -> None:
            self._files.sync()
            self._flushed = count

        self._submit(flush)

    @property
    def unflushed(self) -> int:
        """Number of messages since the last completed flush. After an error, at most these are missing in the file."""
        return self.count - self._flushed

    def check_disk(self, min_free: int) -> None:
        """Check that the current file still exists and that its disk has ``min_free`` [bytes] of free space.

        Raises:
            BagWriteError: if the file is missing or the space is too small. The bag stays open, so that :meth:`close`
                can use the remaining space for the index.
        """
        try:
            self.path.stat()
            space = os.statvfs(self.folder)
        except OSError as error:
            raise BagWriteError(f"{self.path} was moved or deleted while it was written: {error.strerror}") from error
        if (free := space.f_bavail * space.f_frsize) < min_free:
            raise BagWriteError(
                f"recording ends: the disk of {self.folder} has {free} bytes of free space: must be >= {min_free}"
            )

    def close(self) -> None:
        """Finish the file and write metadata.yaml; no effect on a closed bag."""
        if self.closed:
            return
        self._submit_rows()
        self._wait_for(self._files.end)
        self.closed = True
        self._worker.shutdown()


def _installed(type_name: str) -> tuple[Schema, str]:
    """Return schema and hash of an installed type; both are empty if it is not installed."""
    schema, hash_text = Schema(0, b"", SchemaEncoding.SelfDescribing, type_name), ""
    with contextlib.suppress(DefinitionNotFoundError):
        schema = Schema(0, schema_text(type_name).encode(), SchemaEncoding.ROS2, type_name)
        hash_text = definitions.type_hash(type_name)
    return schema, hash_text


@contextlib.contextmanager
def new_bag(folder: Path) -> Iterator[BagWriter]:
    """Yield the writer of a bag that appears at ``folder`` when the ``with`` block ends without an exception.

    Files that the caller adds to the bag have to be written into the writer's ``folder``.

    Raises:
        BagWriteError: if ``folder`` already exists or cannot be written.
    """
    folder = expanded(folder).absolute()
    if os.path.lexists(folder):
        raise BagWriteError(f"{folder} already exists: choose another name for the bag")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".part", dir=folder.parent))
        try:
            # Names of files contain the name of the folder, so the temporary folder has the name of the bag.
            writer = BagWriter(part / folder.name)
            try:
                yield writer
            finally:
                writer.close()
            writer.folder.rename(folder)
        finally:
            shutil.rmtree(part, ignore_errors=True)
    except OSError as error:
        raise BagWriteError(f"cannot write the bag {folder}: {error.strerror or error}") from error
