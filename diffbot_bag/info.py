"""Describe a bag: its files and topics, and figures of each topic from one pass over the messages."""

from __future__ import annotations

import re
import struct
from array import array
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_bag.bag import BagReader, RawMessage
from diffbot_bag.losses import LossCounter
from diffbot_bag.player import GAP
from diffbot_bag.qos import Qos, to_plain
from diffbot_core.stamps import NS_PER_S

SCHEMA_VERSION = 2
"""of :func:`info_as_plain`; it grows when a key changes its meaning or is removed"""
_STAMP = {True: struct.Struct("<iI"), False: struct.Struct(">iI")}
"""Seconds and nanoseconds of a stamp; True: little-endian."""
_STAMP_AT = 4
"""[bytes] the encapsulation header of CDR comes first"""
_BEGINS_WITH_HEADER = re.compile(
    r"(?:[ \t]*(?:#.*|[^#\n=]+=.*)?\r?\n)*[ \t]*(?:std_msgs/(?:msg/)?)?Header[ \t]+\w"
).match
"""Matches a definition whose first field is a header; comments and constants may precede."""


class FileInfo(NamedTuple):
    """One MCAP file."""

    name: str
    size: int
    """[bytes]"""


class Latency(NamedTuple):
    """Log time minus stamp [s]; negative for a stamp in the future."""

    smallest: float
    median: float
    p99: float


class TopicFigures(NamedTuple):
    """Figures from the messages of a topic in the order of log time; None where the messages do not tell."""

    bytes: int
    """of all messages, unpacked"""
    first: int
    """[ns] log time of the first message; 0 without messages"""
    last: int
    rate: float | None
    """[Hz] number of intervals over the time from the first to the last message"""
    gap: float | None
    """[s] longest time between neighbouring messages"""
    gap_begin: int | None
    """[ns] log time at which it begins"""
    latency: Latency | None
    """of the messages with a stamp other than 0"""
    unstamped: int | None
    """messages whose stamp is 0 or cannot be read; None if the type has no header"""
    stamps_back: int | None
    """messages whose stamp is earlier than that of the previous message"""
    stamp_gap: float | None
    """[s] longest step from one stamp to the next; unlike the gap, it does not grow when the recorder is late"""
    missing: int | None
    """numbers that are missing in the sequence; None if the writer of the bag gave no sequence numbers"""


class TopicInfo(NamedTuple):
    """One topic."""

    name: str
    type: str
    encoding: str
    """of the messages: ``cdr``, ``protobuf``, ``json``, ``ros1`` ..."""
    message_count: int
    qos: tuple[Qos, ...]
    """offered by each publisher"""
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
    topics: tuple[TopicInfo, ...]
    """in the order of their names"""
    recorder_lost: int | None
    """all messages that the recorder reports as lost"""
    jumps: tuple[tuple[int, int], ...]
    """log times [ns] before and after each jump of the log time; empty if the messages were not read"""

    @property
    def size(self) -> int:
        """Size of all files [bytes]."""
        return sum(file.size for file in self.files)

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(topic.message_count for topic in self.topics)

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


def info_of(
    reader: BagReader,
    *,
    quick: bool = False,
    progress: Callable[[int], None] = lambda _: None,
    observe: Callable[[RawMessage], None] = lambda _: None,
) -> BagInfo:
    """Describe an open bag.

    Args:
        reader: the bag.
        quick: read only the index and metadata.yaml; topics have no figures then.
        progress: called with 1 for each message.
        observe: called with each message, for readers that need more than the figures.

    Raises:
        DiffbotError: if a file turns out to be damaged.
    """
    columns: dict[str, _Columns] = {}
    if not quick:
        definitions = reader.definitions
        columns = {name: _Columns(bool(_BEGINS_WITH_HEADER(definitions.get(name, "")))) for name in reader.topics}
        for message in reader.messages():
            columns[message.topic].add(message)
            observe(message)
            progress(1)
    losses = _reported_losses(reader.custom_data)
    topics = [
        TopicInfo(
            name=name,
            type=topic.type,
            encoding=topic.encoding,
            message_count=topic.message_count,
            qos=topic.qos,
            recorder_lost=None if losses is None else losses.get(name, 0),
            figures=columns[name].figures(max(len(topic.qos), 1)) if columns else None,
        )
        for name, topic in sorted(reader.topics.items())
    ]
    return BagInfo(
        path=reader.path,
        files=tuple(FileInfo(file.name, file.stat().st_size) for file in reader.files),
        distro=reader.metadata.ros_distro if reader.metadata else "",
        start=reader.start,
        end=reader.end,
        topics=tuple(topics),
        recorder_lost=None if losses is None else losses.get("", 0),
        jumps=_jumps([one.times for one in columns.values()]),
    )


class _Columns:
    """Columns of the messages of one topic, 20 bytes a message."""

    def __init__(self, is_stamped: bool) -> None:
        self.is_stamped = is_stamped
        self.size = 0
        self.times = array("Q")
        self.sequences = array("I")
        self.stamps = array("q")

    def add(self, message: RawMessage) -> None:
        data = message.data
        self.size += len(data)
        self.times.append(message.log_time)
        self.sequences.append(message.sequence)
        if self.is_stamped:
            try:
                seconds, nanoseconds = _STAMP[data[1] & 1 == 1].unpack_from(data, _STAMP_AT)
            except (struct.error, IndexError):
                seconds = nanoseconds = 0
            self.stamps.append(seconds * NS_PER_S + nanoseconds)

    def figures(self, publishers: int) -> TopicFigures:
        """Compute the figures; ``publishers`` is the number of interleaved sequences."""
        times = np.array(self.times, np.int64)
        gaps = np.diff(times)
        span = (times[-1] - times[0]) / NS_PER_S if len(times) else 0.0
        stamps = np.array(self.stamps, np.int64)
        known = stamps != 0
        steps = np.diff(stamps[known])
        return TopicFigures(
            bytes=self.size,
            first=int(times[0]) if len(times) else 0,
            last=int(times[-1]) if len(times) else 0,
            rate=float(len(gaps) / span) if span > 0.0 else None,
            gap=float(gaps.max() / NS_PER_S) if len(gaps) else None,
            gap_begin=int(times[gaps.argmax()]) if len(gaps) else None,
            latency=_latency(times[known] - stamps[known]) if known.any() else None,
            unstamped=int(np.count_nonzero(~known)) if self.is_stamped else None,
            stamps_back=int(np.count_nonzero(steps < 0)) if self.is_stamped else None,
            stamp_gap=max(float(steps.max()) / NS_PER_S, 0.0) if len(steps) else None,
            missing=_missing(self.sequences, publishers) if any(self.sequences) else None,
        )


def _latency(delays: NDArray[np.int64]) -> Latency:
    median, p99 = np.quantile(delays, (0.5, 0.99), method="inverted_cdf")
    return Latency(float(delays.min()) / NS_PER_S, float(median) / NS_PER_S, float(p99) / NS_PER_S)


def _missing(sequences: array[int], publishers: int) -> int:
    counter = LossCounter(lambda: publishers)
    for number in sequences:
        counter.note(number)
    return counter.lost


def _jumps(all_times: list[array[int]]) -> tuple[tuple[int, int], ...]:
    """Return the log times before and after each silence longer than GAP."""
    times = np.sort(np.concatenate([np.array(one, np.int64) for one in all_times])) if all_times else np.zeros(0)
    at = np.flatnonzero(np.diff(times) > GAP)
    return tuple((int(times[index]), int(times[index + 1])) for index in at)


def _reported_losses(data: Mapping[str, str]) -> dict[str, int] | None:
    """Return the losses that the recorder reports, by topic and in total (empty name); None without a report."""
    counts = {key: int(value) for key, value in data.items() if key.startswith("lost") and value.isdecimal()}
    if "lost_messages" not in counts:
        return None
    return {"" if key == "lost_messages" else key.removeprefix("lost "): count for key, count in counts.items()}


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
        "jumps": [{"before": before, "after": after} for before, after in info.jumps],
        "topics": [_topic_as_plain(topic) for topic in info.topics],
    }


def _topic_as_plain(topic: TopicInfo) -> dict[str, Any]:
    figures: Mapping[str, Any] = topic.figures._asdict() if topic.figures else dict.fromkeys(TopicFigures._fields)
    latency = topic.figures.latency if topic.figures else None
    return {
        "name": topic.name,
        "type": topic.type,
        "encoding": topic.encoding,
        "messages": topic.message_count,
        "lost": topic.lost,
        "qos": [to_plain(qos) for qos in topic.qos],
        **{name: value for name, value in figures.items() if name != "missing"},
        "latency": latency._asdict() if latency else None,
    }
