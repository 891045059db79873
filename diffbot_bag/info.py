"""Describe a bag: its files, its topics, and figures of each topic computed from all messages."""

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
from diffbot_bag.metadata import LOST, losses_of
from diffbot_bag.player import GAP
from diffbot_bag.qos import Qos, to_plain
from diffbot_core.stamps import NS_PER_S

SCHEMA_VERSION = 2
"""Version of the result of :func:`info_as_plain`; increased when a key is removed or changes its meaning."""
_STAMP = {True: struct.Struct("<iI"), False: struct.Struct(">iI")}
"""Seconds and nanoseconds of a stamp; the key True is for little-endian bytes."""
_STAMP_AT = 4
"""[bytes] offset of the first field, after the encapsulation header of CDR"""
_BEGINS_WITH_HEADER = re.compile(
    r"(?:[ \t]*(?:#.*|[^#\n=]+=.*)?\r?\n)*[ \t]*(?:std_msgs/(?:msg/)?)?Header[ \t]+\w"
).match
"""Matches a definition whose first field is a header, after any comments and constants."""


class FileInfo(NamedTuple):
    """One MCAP file."""

    name: str
    size: int
    """[bytes]"""


class TopicLatency(NamedTuple):
    """Log time minus stamp [s]; negative if a stamp is in the future."""

    smallest: float
    median: float
    p99: float


class TopicFigures(NamedTuple):
    """Figures of the messages of a topic in the order of log time; None if a figure cannot be computed."""

    bytes: int
    """[bytes] size of all messages, uncompressed"""
    first: int
    """[ns] log time of the first message; 0 without messages"""
    last: int
    """[ns] log time of the last message; 0 without messages"""
    rate: float | None
    """[Hz] number of intervals divided by the time from the first to the last message"""
    gap: float | None
    """[s] longest time between two consecutive messages"""
    gap_begin: int | None
    """[ns] log time at which the longest gap begins"""
    latency: TopicLatency | None
    """latency of the messages with a stamp other than 0"""
    unstamped: int | None
    """number of messages whose stamp is 0 or cannot be read; None if the type does not have a header"""
    stamps_back: int | None
    """number of messages whose stamp is earlier than the previous stamp"""
    stamp_gap: float | None
    """[s] longest step between two consecutive stamps; it does not depend on delays of the recorder"""
    missing: int | None
    """number of missing sequence numbers; None if the bag does not contain sequence numbers"""


class TopicInfo(NamedTuple):
    """One topic."""

    name: str
    type: str
    encoding: str
    """encoding of the messages: ``cdr``, ``protobuf``, ``json``, ``ros1`` ..."""
    message_count: int
    qos: tuple[Qos, ...]
    """QoS that each publisher offered"""
    recorder_lost: int | None
    """number of lost messages that the recorder reported; None if the bag does not contain its report"""
    figures: TopicFigures | None
    """None if the messages were not read"""

    @property
    def lost(self) -> int | None:
        """Number of lost messages: by the recorder's report or, without it, by the missing sequence numbers.

        The recorder counts the messages during a pause, but does not record them. So their numbers are missing.
        """
        missing = self.figures.missing if self.figures else None
        return missing if self.recorder_lost is None else self.recorder_lost


class BagInfo(NamedTuple):
    """Description of a bag."""

    path: Path
    files: tuple[FileInfo, ...]
    distro: str
    start: int
    """[ns] log time of the first message"""
    end: int
    """[ns] log time of the last message"""
    topics: tuple[TopicInfo, ...]
    """topics in alphabetical order"""
    recorder_lost: int | None
    """number of lost messages of all topics that the recorder reported; None without its report"""
    jumps: tuple[tuple[int, int], ...]
    """log times [ns] at start and end of each gap longer than GAP; empty if the messages were not read"""

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
        """Number of lost messages of all topics; None if it is unknown for each topic and for the bag."""
        if self.recorder_lost is not None:
            return self.recorder_lost
        known = [topic.lost for topic in self.topics if topic.lost is not None]
        return sum(known) if known else None


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
        quick: read only the index and metadata.yaml, without figures of topics.
        progress: called with 1 for each message.
        observe: called with each message, for callers that compute more than the figures.

    Raises:
        DiffbotError: if a file is damaged.
    """
    columns: dict[str, _Columns] = {}
    if not quick:
        definitions = reader.definitions
        columns = {name: _Columns(bool(_BEGINS_WITH_HEADER(definitions.get(name, "")))) for name in reader.topics}
        for message in reader.messages():
            columns[message.topic].add(message)
            observe(message)
            progress(1)
    losses = losses_of(reader.custom_data)
    topics = [
        TopicInfo(
            name=name,
            type=topic.type,
            encoding=topic.encoding,
            message_count=topic.message_count,
            qos=topic.qos,
            recorder_lost=losses.get(f"lost {name}", 0) if LOST in losses else None,
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
        recorder_lost=losses.get(LOST),
        jumps=_jumps([column.times for column in columns.values()]),
    )


class _Columns:
    """Times, stamps and sequence numbers of the messages of one topic, 20 bytes per message."""

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
        """Compute the figures; ``publishers`` is the number of publishers whose sequence numbers are interleaved."""
        times = np.array(self.times, np.int64)
        gaps = np.diff(times)
        span = (times[-1] - times[0]) / NS_PER_S if len(times) else 0.0
        stamps = np.array(self.stamps, np.int64)
        has_stamp = stamps != 0
        steps = np.diff(stamps[has_stamp])
        return TopicFigures(
            bytes=self.size,
            first=int(times[0]) if len(times) else 0,
            last=int(times[-1]) if len(times) else 0,
            rate=float(len(gaps) / span) if span > 0.0 else None,
            gap=float(gaps.max() / NS_PER_S) if len(gaps) else None,
            gap_begin=int(times[gaps.argmax()]) if len(gaps) else None,
            latency=_latency(times[has_stamp] - stamps[has_stamp]) if has_stamp.any() else None,
            unstamped=int(np.count_nonzero(~has_stamp)) if self.is_stamped else None,
            stamps_back=int(np.count_nonzero(steps < 0)) if self.is_stamped else None,
            stamp_gap=max(float(steps.max()) / NS_PER_S, 0.0) if len(steps) else None,
            missing=_missing(self.sequences, publishers) if any(self.sequences) else None,
        )


def _latency(delays: NDArray[np.int64]) -> TopicLatency:
    median, p99 = np.quantile(delays, (0.5, 0.99), method="inverted_cdf")
    return TopicLatency(float(delays.min()) / NS_PER_S, float(median) / NS_PER_S, float(p99) / NS_PER_S)


def _missing(sequences: array[int], publishers: int) -> int:
    counter = LossCounter(lambda: publishers)
    for number in sequences:
        counter.note(number)
    return counter.lost


def _jumps(all_times: list[array[int]]) -> tuple[tuple[int, int], ...]:
    """Return the log times at start and end of each gap longer than GAP."""
    if not all_times:
        return ()
    times = np.sort(np.concatenate([np.array(topic_times, np.int64) for topic_times in all_times]))
    starts = np.flatnonzero(np.diff(times) > GAP)
    return tuple((int(times[index]), int(times[index + 1])) for index in starts)


def info_as_plain(info: BagInfo) -> dict[str, Any]:
    """Return the content of ``diffbot bag info --json``, which docs/reference/bags.md describes."""
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
