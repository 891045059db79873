"""metadata.yaml of a rosbag2 bag: written as version 9, read in any version; errors are one line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from diffbot_bag.bag.qos import Qos, load_profiles, to_plain
from diffbot_core.bounded_yaml import MAX_CHARACTERS, dump_yaml, load_yaml
from diffbot_core.errors import DiffbotError
from diffbot_core.files import write_text
from diffbot_core.foreign_files import read_text, shown

FILE_NAME = "metadata.yaml"
ROOT = "rosbag2_bagfile_information"
VERSION = 9
RECORD_NAME, TEXT_KEY = "rosbag2", "serialized_metadata"
"""Name of the MCAP record with the same map as metadata.yaml, and the key of its text."""
QOS_KEY, HASH_KEY = "offered_qos_profiles", "topic_type_hash"
"""What rosbag2 notes of an MCAP channel."""


class Topic(NamedTuple):
    """A topic of a bag."""

    name: str
    type: str
    """``pkg/msg/Type``."""
    type_hash: str = ""
    """``RIHS01_...``, empty if unknown."""
    qos: tuple[Qos, ...] = ()
    """What each publisher offered when recording began."""
    message_count: int = 0


class FileInformation(NamedTuple):
    """One file of a bag; times in [ns]."""

    name: str
    start: int = 0
    duration: int = 0
    message_count: int = 0


class BagMetadata(NamedTuple):
    """Contents of metadata.yaml; times in [ns]."""

    files: tuple[str, ...] = ()
    """Names of the MCAP files, relative to the folder, in the order of recording."""
    start: int = 0
    duration: int = 0
    message_count: int = 0
    topics: tuple[Topic, ...] = ()
    custom_data: Mapping[str, str] = {}
    ros_distro: str = "jazzy"
    file_information: tuple[FileInformation, ...] = ()
    """One for each of ``files``; empty: each has start, duration and count of the bag."""


def of_files(
    files: Sequence[FileInformation], topics: Sequence[Topic], custom_data: Mapping[str, str], ros_distro: str
) -> BagMetadata:
    """Return the metadata of a bag of these files; start and end are those of the files that have messages."""
    filled = [file for file in files if file.message_count]
    start = min((file.start for file in filled), default=0)
    return BagMetadata(
        files=tuple(file.name for file in files),
        start=start,
        duration=max((file.start + file.duration for file in filled), default=0) - start,
        message_count=sum(file.message_count for file in filled),
        topics=tuple(topics),
        custom_data=custom_data,
        ros_distro=ros_distro,
        file_information=tuple(files),
    )


def to_record(bag: BagMetadata) -> dict[str, str]:
    """Return the contents of the MCAP record RECORD_NAME."""
    return {TEXT_KEY: to_yaml(bag, root=False)}


def to_yaml(bag: BagMetadata, *, root: bool = True) -> str:
    """Return the YAML text; without ``root`` only the inner map, as the MCAP record ``rosbag2`` holds it."""
    one_by_one = bag.file_information or tuple(
        FileInformation(name, bag.start, bag.duration, bag.message_count) for name in bag.files
    )
    inner: dict[str, Any] = {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": bag.duration},
        "starting_time": {"nanoseconds_since_epoch": bag.start},
        "message_count": bag.message_count,
        "topics_with_message_count": [_topic_to_plain(topic) for topic in bag.topics],
        # These two describe rosbag2's compression of whole files or messages, not that of MCAP's chunks.
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": list(bag.files),
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.start},
                "duration": {"nanoseconds": file.duration},
                "message_count": file.message_count,
            }
            for file in one_by_one
        ],
        "custom_data": dict(bag.custom_data) or None,
        "ros_distro": bag.ros_distro,
    }
    return dump_yaml({ROOT: inner} if root else inner)


def _topic_to_plain(topic: Topic) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type,
            "serialization_format": "cdr",
            "offered_qos_profiles": [to_plain(qos) for qos in topic.qos],
            "type_description_hash": topic.type_hash,
        },
        "message_count": topic.message_count,
    }


def write(folder: Path, bag: BagMetadata) -> None:
    """Write metadata.yaml; it appears whole or not at all.

    Raises:
        OSError: if the disk is full or the folder is missing.
    """
    write_text(folder / FILE_NAME, to_yaml(bag), durable=True, in_bag=True)


def read(folder: Path) -> BagMetadata:
    """Read metadata.yaml of a bag's folder, of any version of rosbag2.

    Raises:
        DiffbotError: if it is not YAML, not the metadata of a rosbag2 bag, or that of a bag that is not MCAP.
    """
    path = folder / FILE_NAME
    content = load_yaml(read_text(path, MAX_CHARACTERS), shown(path))
    inner = content.get(ROOT) if isinstance(content, dict) else None
    if not isinstance(inner, dict):
        raise DiffbotError(f"{path} has no {ROOT}: not the metadata of a rosbag2 bag")
    storage = inner.get("storage_identifier")
    if storage != "mcap":
        raise DiffbotError(f"{path}: storage_identifier = {shown(storage)!r}: must be mcap (see `ros2 bag convert`)")
    if inner.get("compression_mode"):
        raise DiffbotError(f"{path}: compression_mode = {shown(inner['compression_mode'])!r}: must be empty")
    try:
        return BagMetadata(
            files=tuple(str(name) for name in inner["relative_file_paths"]),
            start=int(inner["starting_time"]["nanoseconds_since_epoch"]),
            duration=int(inner["duration"]["nanoseconds"]),
            message_count=int(inner["message_count"]),
            topics=tuple(_topic_from_plain(topic) for topic in inner["topics_with_message_count"] or ()),
            custom_data=dict(inner.get("custom_data") or {}),
            ros_distro=str(inner.get("ros_distro", "")),
            file_information=tuple(_file_from_plain(file) for file in inner.get("files") or ()),
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
    )
