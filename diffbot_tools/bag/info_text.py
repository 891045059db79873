"""Texts of ``diffbot bag info`` and ``diffbot bag repair`` for a terminal."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from diffbot_bag.info import BagInfo, TopicFigures, TopicInfo
from diffbot_bag.player import duration_text
from diffbot_bag.repair import Damage, Repaired
from diffbot_core.errors import shown

_COLUMNS = ("Topic", "rate [Hz]", "gap [s]", "lost", "latency [ms]", "p99 [ms]", "size", "QoS")
_LABEL = 19
"""width of the labels of ``ros2 bag info``"""
_SERVICE_EVENTS = "/_service_event"
MAX_LISTED = 10
"""largest number of damaged places and of time jumps that are listed; the rest is counted"""


def info_text(info: BagInfo) -> str:
    """Return the lines of ``ros2 bag info``, followed by a table of figures."""
    services = [topic for topic in info.topics if _is_service(topic)]
    topics = [topic for topic in info.topics if not _is_service(topic)]
    lines = [
        *_listed("Files", [shown(file.name) for file in info.files]),
        _line("Bag size", _size_text(info.size)),
        _line("Storage id", "mcap"),
        _line("ROS Distro", shown(info.distro or "unknown")),
        _line("Duration", f"{_seconds(info.duration)}s"),
        _line("Start", _time_text(info.start)),
        _line("End", _time_text(info.end)),
        _line("Messages", str(sum(topic.message_count for topic in topics))),
        *_listed("Topic information", [_entry("Topic", topic, "Count") for topic in topics]),
        _line("Service", str(len(services))),
        *_listed("Service information", [_entry("Service", topic, "Event Count") for topic in services]),
        _line("Lost", "unknown" if info.lost is None else str(info.lost)),
        *_jumps(info),
    ]
    if rows := [_figures_row(topic, topic.figures) for topic in info.topics if topic.figures]:
        lines += ["", *_table([_COLUMNS, *rows])]
    return "\n".join(line.rstrip() for line in lines)


def _is_service(topic: TopicInfo) -> bool:
    return topic.name.endswith(_SERVICE_EVENTS) and topic.type.endswith("_Event")


def _line(label: str, text: str) -> str:
    return f"{label + ':':<{_LABEL}}{text}"


def _listed(label: str, texts: Sequence[str]) -> list[str]:
    first, *rest = texts or ("",)
    width = max(_LABEL, len(label) + 2)
    return [f"{label + ':':<{width}}{first}", *(" " * width + text for text in rest)]


def _entry(kind: str, topic: TopicInfo, count: str) -> str:
    name, type_name = topic.name, topic.type
    if kind == "Service":
        name, type_name = name.removesuffix(_SERVICE_EVENTS), type_name.removesuffix("_Event")
    return (
        f"{kind}: {shown(name)} | Type: {shown(type_name)} | {count}: {topic.message_count}"
        f" | Serialization Format: {shown(topic.encoding)}"
    )


def _jumps(info: BagInfo) -> list[str]:
    lines = [
        f"no messages for {duration_text(after - before)}, from {(before - info.start) * 1e-9:.3f} s on"
        " (`diffbot replay --skip-gaps` skips it)"
        for before, after in info.jumps[:MAX_LISTED]
    ]
    if more := len(info.jumps) - len(lines):
        lines.append(f"and {more} more gaps longer than 60 s")
    return _listed("Time jump", lines) if lines else []


def _size_text(size: float) -> str:
    """Return a number of bytes in the format of rosbag2."""
    for unit in ("B", "KiB", "MiB", "GiB"):
        if size < 1024:
            return f"{size:.{0 if unit == 'B' else 1}f} {unit}"
        size /= 1024
    return f"{size:.1f} TiB"


def _seconds(nanoseconds: int) -> str:
    return "{}.{:09d}".format(*divmod(nanoseconds, 10**9))


def _time_text(nanoseconds: int) -> str:
    local = time.localtime(nanoseconds // 10**9)
    date = f"{time.strftime('%b', local)} {local.tm_mday:2d} {local.tm_year}"
    return f"{date} {time.strftime('%H:%M:%S', local)}.{nanoseconds % 10**9:09d} ({_seconds(nanoseconds)})"


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _figures_row(topic: TopicInfo, figures: TopicFigures) -> tuple[str, ...]:
    latency = figures.latency
    offers = dict.fromkeys(f"{qos.reliability} {qos.durability}" for qos in topic.qos)
    return (
        shown(topic.name),
        _number(figures.rate, 2),
        _number(figures.gap, 3),
        _number(topic.lost, 0),
        _number(latency and latency.median * 1e3, 3),
        _number(latency and latency.p99 * 1e3, 3),
        _size_text(figures.bytes),
        ", ".join(offers) or "-",
    )


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    ends = (0, len(widths) - 1)
    return [
        "  ".join(
            f"{text:<{width}}" if column in ends else f"{text:>{width}}"
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]


def repair_text(out: Path, repaired: Repaired) -> str:
    """Return lines about the messages that were saved in the bag ``out``, and about the losses."""
    bag = repaired.metadata
    topics = sum(topic.message_count > 0 for topic in bag.topics)
    lines = [f"{shown(out)}: {bag.message_count} messages of {topics} topics in {bag.duration * 1e-9:.3f} s"]
    lines += [f"lost: the whole file {shown(name)}, which is missing" for name in repaired.missing]
    lines += [
        f"{shown(name)} did not have a valid index: it was cut off, not finished or damaged at its end"
        for name in repaired.without_index
    ]
    lines += [
        f"{shown(damage.file)}: lost: {damage.size} damaged bytes, {_place(damage, bag.start)}"
        for damage in repaired.damages[:MAX_LISTED]
    ]
    if len(repaired.damages) > MAX_LISTED:
        lines.append(f"lost: {len(repaired.damages) - MAX_LISTED} more damaged places")
    if repaired.lost:
        counts = ", ".join(f"{topic} {count}" for topic, count in sorted(repaired.lost.items()))
        lines.append(f"lost: {repaired.lost.total()} messages that the index lists ({shown(counts)})")
    if repaired.unknown:
        lines.append(f"the names of these topics are lost: {shown(', '.join(repaired.unknown))}")
    if not (repaired.missing or repaired.damages or repaired.lost or repaired.unknown):
        lines.append("all messages of the files are saved")
    return "\n".join(lines)


def _place(damage: Damage, start: int) -> str:
    before, after = (None if time is None else f"{(time - start) * 1e-9:.3f} s" for time in damage[-2:])
    if before and after:
        return f"between {before} and {after}"
    return f"after {before}" if before else f"before {after}" if after else "at an unknown time"
