"""What a bag holds: its files and topics, and figures of each topic from one pass over the messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from diffbot_bag.bag.metadata import BagMetadata, Topic
from diffbot_bag.bag.qos import Qos, to_plain
from diffbot_bag.bag.reader import BagReader
from diffbot_bag.mcap.file import McapFile
from diffbot_bag.tools.header_stamps import begins_with_header
from diffbot_bag.tools.topic_figures import TopicFigures, TopicMeter
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import shown
from diffbot_core.units import NS_PER_S

SCHEMA_VERSION = 1
"""of :func:`info_as_plain`; it grows when a key changes its meaning or goes away"""
MAX_TOPICS = 10_000
"""of a bag whose figures are computed: each takes some kB"""
_PROGRESS_STEP = 1000
Observer = Callable[[int, bytes], None]
"""Takes log time [ns] and data of a message."""


class FileInfo(NamedTuple):
    """One MCAP file."""

    name: str
    size: int
    """[bytes]"""
    message_count: int


class ChunkTotals(NamedTuple):
    """Chunks of all files that are compressed in one way."""

    kind: str
    """``zstd``, ``lz4`` or ``none``"""
    chunks: int
    packed: int
    """[bytes] in the files"""
    unpacked: int


class TopicInfo(NamedTuple):
    """One topic."""

    name: str
    type: str
    message_count: int
    qos: tuple[Qos, ...]
    """what each publisher offered"""
    recorder_lost: int | None
    """messages that the recorder reports as lost; None if it reports none of its losses"""
    figures: TopicFigures | None
    """None if the messages were not read"""

    @property
    def lost(self) -> int | None:
        """Lost messages by the recorder's report or the sequence numbers, whichever has more; None if neither tells."""
        known = [self.recorder_lost, self.figures.missing if self.figures else None]
        return max((one for one in known if one is not None), default=None)


class BagInfo(NamedTuple):
    """A bag."""

    path: Path
    files: tuple[FileInfo, ...]
    distro: str
    start: int
    """[ns] log time of the first message"""
    end: int
    compression: tuple[ChunkTotals, ...]
    topics: tuple[TopicInfo, ...]
    """in the order of their names"""
    recorder_lost: int | None
    """all messages that the recorder reports as lost"""

    @property
    def size(self) -> int:
        """Size of all files [bytes]."""
        return sum(file.size for file in self.files)

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(file.message_count for file in self.files)

    @property
    def duration(self) -> int:
        """Time from the first to the last message [ns]."""
        return self.end - self.start

    @property
    def lost(self) -> int | None:
        """Lost messages of all topics; None if nothing in the bag tells."""
        known = [topic.lost for topic in self.topics if topic.lost is not None]
        by_topic = sum(known) if known else None
        return max((one for one in (by_topic, self.recorder_lost) if one is not None), default=None)


def read_info(
    path: Path,
    *,
    quick: bool = False,
    observers: Mapping[str, Observer] | None = None,
    progress: Callable[[int], None] | None = None,
) -> BagInfo:
    """Read what a bag holds; memory does not grow with the number of messages.

    Args:
        path: folder or MCAP file.
        quick: only the index and metadata.yaml; topics have no figures then.
        observers: for topics whose messages are wanted, too.
        progress: called with the number of messages since its last call.

    Raises:
        DiffbotError: if it is no bag, or is damaged.
    """
    with BagReader(path) as reader:
        if quick:
            return _info(reader, {})
        return info_of(reader, {name: [one] for name, one in (observers or {}).items()}, progress)


def info_of(
    reader: BagReader, observers: Mapping[str, Sequence[Observer]], progress: Callable[[int], None] | None = None
) -> BagInfo:
    """Do the same with an open bag and any number of observers for a topic.

    Raises:
        DiffbotError: if a file turns out to be damaged.
    """
    meters = _meters(reader)
    takers = {name: (meter, observers.get(name, ())) for name, meter in meters.items()}
    unreported = 0
    for log_time, topic, sequence, _, data in reader.rows(meters):
        meter, wanted = takers[topic]
        meter.add(log_time, data, sequence)
        for take in wanted:
            take(log_time, data)
        unreported += 1
        if progress is not None and unreported == _PROGRESS_STEP:
            progress(unreported)
            unreported = 0
    if progress is not None:
        progress(unreported)
    return _info(reader, meters)


def _info(reader: BagReader, meters: Mapping[str, TopicMeter]) -> BagInfo:
    topics, losses = reader.topics, _reported_losses(reader.metadata)
    return BagInfo(
        path=reader.path,
        files=tuple(FileInfo(file.path.name, file.size, file.message_count) for file in reader.files),
        distro=reader.metadata.ros_distro if reader.metadata else "",
        start=reader.start,
        end=reader.end,
        compression=tuple(_compressions(reader.files)),
        topics=tuple(_topic_info(topics[name], losses, meters.get(name)) for name in sorted(topics)),
        recorder_lost=None if losses is None else losses.get("", 0),
    )


def _meters(reader: BagReader) -> dict[str, TopicMeter]:
    """Return an empty meter for each topic of a bag."""
    if (number := len(reader.topics)) > MAX_TOPICS:
        raise DiffbotError(f"{shown(reader.path)} has {number} topics: must be <= {MAX_TOPICS}")
    publishers: dict[str, int] = {}
    for file in reader.files:
        in_file: dict[str, int] = {}
        for topic in file.topics():
            in_file[topic.name] = in_file.get(topic.name, 0) + max(len(topic.qos), 1)
        publishers |= {name: max(count, publishers.get(name, 0)) for name, count in in_file.items()}
    definitions = reader.definitions
    is_stamped = {text: begins_with_header(text) for text in set(definitions.values())}
    return {
        name: TopicMeter(is_stamped.get(definitions.get(name, ""), False), count) for name, count in publishers.items()
    }


def _topic_info(topic: Topic, losses: dict[str, int] | None, meter: TopicMeter | None) -> TopicInfo:
    figures = meter.figures() if meter else None
    lost = None if losses is None else losses.get(topic.name, 0)
    return TopicInfo(topic.name, topic.type, topic.message_count, topic.qos, lost, figures)


def _reported_losses(metadata: BagMetadata | None) -> dict[str, int] | None:
    """Return what the recorder reports as lost by topic, of all under the empty name; None without a report."""
    data = metadata.custom_data if metadata else {}
    total = str(data.get("lost_messages", ""))
    if not _is_number(total):
        return None
    topics = {key.removeprefix("lost "): str(value) for key, value in data.items() if str(key).startswith("lost /")}
    return {"": int(total)} | {name: int(value) for name, value in topics.items() if _is_number(value)}


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 20


def _compressions(files: Iterable[McapFile]) -> list[ChunkTotals]:
    found: dict[str, ChunkTotals] = {}
    for file in files:
        for chunk in file.chunks:
            kind = shown(chunk.compression or "none")
            _, count, packed, unpacked = found.get(kind, ChunkTotals(kind, 0, 0, 0))
            packed += chunk.compressed_size
            found[kind] = ChunkTotals(kind, count + 1, packed, unpacked + chunk.uncompressed_size)
    return [found[kind] for kind in sorted(found)]


def info_as_plain(info: BagInfo) -> dict[str, Any]:
    """Return the content of ``diffbot bag info --json``; docs/reference/bags.md describes it."""
    return {
        "schema_version": SCHEMA_VERSION,
        "path": str(info.path),
        "storage": "mcap",
        "ros_distro": info.distro or None,
        "files": [file._asdict() for file in info.files],
        "size": info.size,
        "start": info.start,
        "end": info.end,
        "duration": info.duration / NS_PER_S,
        "messages": info.message_count,
        "lost": info.lost,
        "compression": [one._asdict() for one in info.compression],
        "topics": [_topic_as_plain(topic) for topic in info.topics],
    }


def _topic_as_plain(topic: TopicInfo) -> dict[str, Any]:
    figures = topic.figures
    latency = figures.latency if figures else None
    return {
        "name": topic.name,
        "type": topic.type,
        "messages": topic.message_count,
        "bytes": figures.bytes if figures else None,
        "first": figures.first if figures and figures.message_count else None,
        "last": figures.last if figures and figures.message_count else None,
        "rate": figures.rate if figures else None,
        "gap": figures.gap if figures else None,
        "gap_begin": figures.gap_begin if figures else None,
        "lost": topic.lost,
        "latency": None if latency is None else latency._asdict(),
        "unstamped": figures.unstamped if figures else None,
        "stamps_back": figures.stamps_back if figures else None,
        "stamp_gap": figures.stamp_gap if figures else None,
        "qos": [to_plain(qos) for qos in topic.qos],
    }
