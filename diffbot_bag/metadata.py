"""Parse and format metadata.yaml of a rosbag2 bag. Any version is read, version 9 is written."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from diffbot_bag.qos import Qos, load_profiles, to_plain
from diffbot_core.errors import DiffbotError, shown
from diffbot_core.files import read_text
from diffbot_core.yaml_files import dump_yaml, load_yaml

FILE_NAME = "metadata.yaml"
ROOT = "rosbag2_bagfile_information"
VERSION = 9
MAX_BYTES = 16 * 2**20
"""[bytes] largest metadata.yaml that is read"""
LOST = "lost_messages"
"""Key in the custom data: number of lost messages of all topics; ``lost <topic>`` is the key of one topic."""


class Topic(NamedTuple):
    """A topic of a bag."""

    name: str
    type: str
    """``pkg/msg/Type``, or the name of the schema for an encoding other than CDR"""
    type_hash: str = ""
    """``RIHS01_...``; empty if unknown"""
    qos: tuple[Qos, ...] = ()
    """QoS that each publisher offered when the recorder subscribed"""
    message_count: int = 0
    encoding: str = "cdr"
    """MCAP's message encoding; metadata.yaml calls it serialization format"""


class FileInformation(NamedTuple):
    """One file of a bag; times in [ns]."""

    name: str
    start: int = 0
    duration: int = 0
    message_count: int = 0


class BagMetadata(NamedTuple):
    """The content of metadata.yaml."""

    files: tuple[FileInformation, ...] = ()
    """MCAP files in the order of recording; names are relative to the folder"""
    topics: tuple[Topic, ...] = ()
    custom_data: Mapping[str, str] = {}
    ros_distro: str = "jazzy"

    @property
    def start(self) -> int:
        """Log time of the first message [ns]; 0 without messages."""
        return min((file.start for file in self.files if file.message_count), default=0)

    @property
    def duration(self) -> int:
        """Time from the first to the last message [ns]."""
        ends = (file.start + file.duration for file in self.files if file.message_count)
        return max(ends, default=self.start) - self.start

    @property
    def message_count(self) -> int:
        """Number of messages in all files."""
        return sum(file.message_count for file in self.files)


def losses_of(custom_data: Mapping[str, str]) -> dict[str, int]:
    """Return the numbers of lost messages in the custom data by their keys; see LOST."""
    counts = {key: value for key, value in custom_data.items() if key == LOST or key.startswith("lost /")}
    return {key: int(value) for key, value in counts.items() if re.fullmatch(r"[0-9]{1,18}", value)}


def without_losses(custom_data: Mapping[str, str]) -> dict[str, str]:
    """Return the custom data without the numbers of lost messages."""
    losses = losses_of(custom_data)
    return {key: value for key, value in custom_data.items() if key not in losses}


def to_yaml(bag: BagMetadata, *, root: bool = True) -> str:
    """Return the YAML text; without ``root``, return only the inner map, as in the MCAP record ``rosbag2``."""
    inner: dict[str, Any] = {
        "version": VERSION,
        "storage_identifier": "mcap",
        **_span_to_plain(bag),
        "topics_with_message_count": [_topic_to_plain(topic) for topic in bag.topics],
        # rosbag2 compresses whole files or messages; these keys do not describe the compression of MCAP chunks.
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in bag.files],
        "files": [{"path": file.name, **_span_to_plain(file)} for file in bag.files],
        "custom_data": dict(bag.custom_data) or None,
        "ros_distro": bag.ros_distro,
    }
    return dump_yaml({ROOT: inner} if root else inner)


def _span_to_plain(span: BagMetadata | FileInformation) -> dict[str, Any]:
    return {
        "duration": {"nanoseconds": span.duration},
        "starting_time": {"nanoseconds_since_epoch": span.start},
        "message_count": span.message_count,
    }


def _topic_to_plain(topic: Topic) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type,
            "serialization_format": topic.encoding,
            "offered_qos_profiles": [to_plain(qos) for qos in topic.qos],
            "type_description_hash": topic.type_hash,
        },
        "message_count": topic.message_count,
    }


def read(folder: Path) -> BagMetadata:
    """Read metadata.yaml in the folder of a bag.

    Raises:
        DiffbotError: if the file is not YAML or does not describe a rosbag2 bag, or if the bag is not stored as MCAP.
    """
    path = folder / FILE_NAME
    content = load_yaml(read_text(path, MAX_BYTES), shown(path))
    inner = content.get(ROOT) if isinstance(content, dict) else None
    if not isinstance(inner, dict):
        raise DiffbotError(f"{path} is not the metadata of a rosbag2 bag: the key {ROOT} is missing")
    storage = inner.get("storage_identifier")
    if storage != "mcap":
        raise DiffbotError(f"{path}: storage_identifier = {shown(storage)!r}: must be mcap (see `ros2 bag convert`)")
    if inner.get("compression_mode"):
        raise DiffbotError(
            f"{path}: compression_mode = {shown(inner['compression_mode'])!r}: must be empty (see `ros2 bag convert`)"
        )
    try:
        known = {str(file["path"]): _file_from_plain(file) for file in inner.get("files") or ()}
        names = [str(name) for name in inner["relative_file_paths"]]
        return BagMetadata(
            files=tuple(known.get(name, FileInformation(name)) for name in names),
            topics=tuple(_topic_from_plain(topic) for topic in inner["topics_with_message_count"] or ()),
            custom_data={str(key): str(value) for key, value in (inner.get("custom_data") or {}).items()},
            ros_distro=str(inner.get("ros_distro", "")),
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DiffbotError(f"{shown(path)} is incomplete: {type(error).__name__} {shown(error)}") from error


def _file_from_plain(plain: Mapping[str, Any]) -> FileInformation:
    return FileInformation(
        name=str(plain["path"]),
        start=int(plain["starting_time"]["nanoseconds_since_epoch"]),
        duration=int(plain["duration"]["nanoseconds"]),
        message_count=int(plain["message_count"]),
    )


def _topic_from_plain(plain: Mapping[str, Any]) -> Topic:
    inner = plain["topic_metadata"]
    return Topic(
        name=str(inner["name"]),
        type=str(inner["type"]),
        type_hash=str(inner.get("type_description_hash", "")),
        qos=load_profiles(inner.get("offered_qos_profiles")),
        message_count=int(plain["message_count"]),
        encoding=str(inner.get("serialization_format", "cdr")),
    )


def path_inside(folder: Path, name: str) -> Path:
    """Return the path of a file of a bag, given the name in its metadata.

    Raises:
        DiffbotError: if the name is absolute, or leads out of the folder by ``..`` or a symbolic link.
    """
    path = folder / name
    try:
        is_inside = not Path(name).is_absolute() and path.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # a null character, a name that is too long, a loop of links
        is_inside = False
    if not is_inside:
        raise DiffbotError(f"{shown(name)} is outside {shown(folder)}, the folder of the bag: it is not read")
    return path
