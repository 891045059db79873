"""QoS of single topics from a YAML file, in the form of ``ros2 bag --qos-profile-overrides-path``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diffbot_bag.bag.qos import MAX_DEPTH, Qos, from_plain
from diffbot_bag.bag.topic_selection import absolute
from diffbot_core.bounded_yaml import load_yaml
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import read_text, shown

MAX_SIZE = 2**20
"""[bytes] of the file"""
_UNKNOWN = ("unknown", "best_available")
"""Policies that are reported, or resolved by discovery, but cannot be asked for here."""


def read_overrides(path: str, depth: int, namespace: str = "/") -> dict[str, Qos]:
    """Return the QoS by absolute topic name; empty for an empty path.

    Args:
        path: of a YAML file: topics, each with a map of policies (history, depth, reliability, durability, deadline,
            lifespan, liveliness, liveliness_lease_duration, avoid_ros_namespace_conventions).
        depth: messages that are queued where a topic gives no depth.
        namespace: of relative topic names.

    Raises:
        DiffbotError: if the file cannot be read, or a topic, policy or value in it is not allowed.
    """
    if not path:
        return {}
    file = Path(path)
    content = load_yaml(read_text(file, MAX_SIZE), f"qos_profile_overrides_path = {shown(file)}")
    if not isinstance(content, Mapping) or not all(isinstance(topic, str) for topic in content):
        raise DiffbotError(f"{shown(file)}: must be a map of topic names to QoS policies")
    return {absolute(topic, namespace): _profile(file, topic, plain, depth) for topic, plain in content.items()}


def _profile(file: Path, topic: str, plain: Any, depth: int) -> Qos:
    where = f"{shown(file)}: {shown(topic)}"
    if not isinstance(plain, Mapping):
        raise DiffbotError(f"{where}: must be a map of QoS policies")
    for name in plain:
        if name not in Qos._fields:
            raise DiffbotError(f"{where}: {shown(name)!r}: must be one of {', '.join(Qos._fields)}")
    try:
        qos = from_plain({"history": "keep_last", "depth": depth, **plain})
    except DiffbotError as error:
        raise DiffbotError(f"{where}: {error}") from error
    if not 1 <= qos.depth <= MAX_DEPTH:
        raise DiffbotError(f"{where}: depth = {qos.depth}: must be >= 1 and <= {MAX_DEPTH}")
    for name in ("history", "reliability", "durability", "liveliness"):
        if getattr(qos, name) in _UNKNOWN:
            raise DiffbotError(f"{where}: {name} = {getattr(qos, name)!r}: must be a policy of a subscription")
    return qos
