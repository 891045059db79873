"""Write a rosbag2 bag: a folder with MCAP files, readable up to the last flush at any time, and metadata.yaml.

The thread that writes messages only collects them. A worker thread packs each batch as one chunk, compresses it and
waits for the disk, so that messages are received meanwhile.
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

CHUNK_SIZE = 512 * 1024
"""[bytes] of a chunk before compression; messages not yet in a chunk are lost if the process dies"""
MAX_BACKLOG = 100 * 2**20
"""[bytes] of messages that wait for the disk"""
COMPRESSIONS = tuple(kind.name.lower() for kind in CompressionType)
_OVERHEAD = 31
"""[bytes] of a message in a chunk besides its data"""


class BagWriteError(DiffbotError):
    """The bag cannot be written; what was flushed before remains readable."""


class BagWriter:
    """Writer of one bag.

    An error of the disk, such as a full one, raises BagWriteError at the call or at a later one, and closes the bag.
    Each file begins with the latched messages of the files before it.
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
            folder: of the bag; it must not exist.
            chunk_size: [bytes] of a chunk before compression.
            compression: one of COMPRESSIONS.
            limits: of each file; None: no limits.
            max_backlog: [bytes] that may wait for the disk; beyond, :meth:`write` waits.

        Raises:
            BagWriteError: if the folder exists already or cannot be created.
        """
        self.folder = Path(folder).expanduser().absolute()
        self._chunk_size, self._max_backlog = chunk_size, max_backlog
        self._rows: list[Row] = []
        self._size = self._channels = self._handed = self._flushed = self._given = self._done = 0
        self.custom_data: Mapping[str, str] = {}
        """notes for metadata.yaml; replace it as a whole"""
        self.closed = False
        """True after :meth:`close` or an error; nothing more can be written"""
        kind = CompressionType[compression.upper()]
        self._files = BagFiles(self.folder, kind, limits or FileLimits(), lambda: self.custom_data)
        self._error: BaseException | None = None
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError as error:
            raise BagWriteError(f"{self.folder} exists already: choose another name for the bag") from error
        except OSError as error:
            raise BagWriteError(f"cannot create the bag {self.folder}: {error.strerror}") from error
        self._worker = ThreadPoolExecutor(1, "bag")
        # Detect a full disk now rather than when the first chunk is full.
        self._run(self._files.begin)
        self._wait_for(self._files.sync)

    @property
    def path(self) -> Path:
        """The present MCAP file, or the last one."""
        return self._files.path

    def _run(self, job: Callable[[], object], size: int = 0) -> Future[object]:
        """Hand a job that writes ``size`` [bytes] to the worker; raise the error of an earlier job."""
        self._raise_failure()
        self._given += size
        return self._worker.submit(self._do, job, size)

    def _do(self, job: Callable[[], object], size: int) -> object:
        try:
            # After an error the file has a gap: nothing may follow.
            return job() if self._error is None else None
        except BaseException as error:  # raised again by the next call of a method
            self._error = error
            return None
        finally:
            self._done += size

    def _wait_for(self, job: Callable[[], object]) -> object:
        result = self._run(job).result()
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
        if not isinstance(error, OSError):
            raise error
        raise BagWriteError(
            f"cannot write {self.path}: {error.strerror}; the bag ends after about {self.count} messages"
            " (it has no index: `diffbot bag repair` makes one)"
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
            name: of the topic.
            type_name: ``pkg/msg/Type``, or the name of the schema of another encoding.
            qos: offered by its publishers.
            type_hash: default: of the installed type.
            encoding: of the messages, in MCAP's words.
            schema: name, encoding and data count; default: the installed definition of the type. A type without one
                gets an empty schema: its messages can be replayed, but not decoded from the bag alone.
        """
        if encoding == CDR:
            known_schema, known_hash = _installed(type_name)
            schema, type_hash = schema or known_schema, type_hash or known_hash
        topic = Topic(name, type_name, type_hash, tuple(qos), 0, encoding)
        self._channels += 1
        if any(one.is_latched for one in topic.qos):
            self._files.latched[self._channels] = LatchedRows(len(topic.qos))
        self._run(partial(self._files.add_channel, topic, schema))
        return self._channels

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add an attachment to this file and the next ones; the newest of equal names counts."""
        self._run(partial(self._files.attach, (name, media_type, data)))

    def write(self, channel: int, data: bytes, log_time: int, publish_time: int, sequence: int = 0) -> None:
        """Append one message; times in [ns].

        Raises:
            DiffbotError: if a time is negative or beyond MAX_TIME; the message is not written.
        """
        if not (0 <= log_time <= MAX_TIME and 0 <= publish_time <= MAX_TIME):
            raise DiffbotError(f"log time {log_time}, publish time {publish_time}: must be in 0..{MAX_TIME}")
        self._rows.append((channel, log_time, data, publish_time, sequence & 0xFFFFFFFF))
        self._size += len(data) + _OVERHEAD
        if self._size > self._chunk_size:
            self._hand_over()

    def _hand_over(self) -> None:
        if not self._rows:
            return
        rows, size = self._rows, self._size
        self._rows, self._size = [], 0
        self._handed += len(rows)
        self._run(partial(self._files.write, rows), size)
        if self._given - self._done > self._max_backlog:
            self._wait_for(lambda: None)

    def is_latched(self, channel: int) -> bool:
        """Return True if a publisher of the channel's topic is transient local."""
        return channel in self._files.latched

    def note_publishers(self, channel: int, count: int) -> None:
        """Set the number of publishers of a topic, which is the number of latched messages to keep."""
        if (latched := self._files.latched.get(channel)) is not None:
            latched.publishers = max(latched.publishers, count)

    def split(self) -> bool:
        """End this file, if it has a message; the next message begins the next file.

        Returns:
            False if the file has no message.
        """
        self._hand_over()
        return bool(self._wait_for(self._files.split))

    def flush(self) -> None:
        """Bring everything written so far to the disk, a moment later; it then survives a crash of the machine.

        A file that has reached its largest size ends: few messages may never fill a chunk.
        """
        self._hand_over()
        count = self.count

        def flush() -> None:
            self._files.sync()
            self._flushed = count

        self._run(flush)

    @property
    def count(self) -> int:
        """Messages written so far, without latched ones that were repeated."""
        return self._handed + len(self._rows)

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
            self.path.stat()
            space = os.statvfs(self.folder)
        except OSError as error:
            raise BagWriteError(f"{self.path} has gone while it was written: {error.strerror}") from error
        if (free := space.f_bavail * space.f_frsize) < min_free:
            raise BagWriteError(f"recording ends: {self.folder} has {free} bytes free: must be >= {min_free}")

    def close(self) -> None:
        """Finish the file and write metadata.yaml; no effect on a closed bag."""
        if self.closed:
            return
        self._hand_over()
        self._wait_for(self._files.end)
        self.closed = True
        self._worker.shutdown()


def _installed(type_name: str) -> tuple[Schema, str]:
    """Return schema and hash of an installed type; empty if its package has none."""
    schema, hash_text = Schema(0, b"", SchemaEncoding.SelfDescribing, type_name), ""
    with contextlib.suppress(DefinitionNotFoundError):
        schema = Schema(0, schema_text(type_name).encode(), SchemaEncoding.ROS2, type_name)
        hash_text = definitions.type_hash(type_name)
    return schema, hash_text


@contextlib.contextmanager
def new_bag(folder: Path) -> Iterator[BagWriter]:
    """Yield the writer of a bag that appears at ``folder`` when the ``with`` block ends; after a failure, nothing does.

    Other files of the bag belong into the writer's ``folder``.

    Raises:
        BagWriteError: if ``folder`` exists already or cannot be written.
    """
    folder = folder.expanduser().absolute()
    if os.path.lexists(folder):
        raise BagWriteError(f"{folder} exists already: choose another name for the bag")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".part", dir=folder.parent))
        try:
            # The temporary folder has the bag's name, as the names of files contain it.
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
