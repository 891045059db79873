"""Quality of service as plain values, and the selection of topics: no ROS is needed.

Policies are named as in rosbag2's YAML. A bag stores the profiles that the publishers of a topic offered. The recorder
chooses a request that matches all offers, the replay an offer that replaces all recorded publishers.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from diffbot_core.errors import DiffbotError, InvalidValueError, shown
from diffbot_core.files import read_text
from diffbot_core.yaml_files import load_yaml

INFINITE = 2**63 - 1
"""[ns] ROS's value of an infinite duration: 9223372036 s 854775807 ns"""
QUEUE_DEPTH = 10_000
"""Messages of a volatile topic that wait for the recorder, or that a replay keeps for slow subscribers."""
MAX_DEPTH = 1_000_000
MAX_FILE_SIZE = 2**20
"""[bytes] of a file with QoS overrides"""
# Up to version 8, metadata.yaml holds policies as the integers of rmw.
_WORDS = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": ("system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available"),
}
_DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")


class Qos(NamedTuple):
    """One QoS profile; policies in rosbag2's words, durations [ns] (INFINITE: no limit)."""

    history: str = "unknown"
    depth: int = 0
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline: int = INFINITE
    lifespan: int = INFINITE
    liveliness: str = "automatic"
    liveliness_lease_duration: int = INFINITE
    avoid_ros_namespace_conventions: bool = False

    @property
    def is_latched(self) -> bool:
        """True if the publisher keeps its last messages for late subscribers."""
        return self.durability == "transient_local"


def to_plain(qos: Qos) -> dict[str, Any]:
    """Return the profile in the form of rosbag2's YAML."""
    plain: dict[str, Any] = qos._asdict()
    for name in _DURATIONS:
        sec, nsec = divmod(plain[name], 10**9)
        plain[name] = {"sec": sec, "nsec": nsec}
    return plain


def from_plain(plain: Mapping[str, Any]) -> Qos:
    """Read a profile written by any version of rosbag2. Missing fields get their defaults, unknown ones are ignored.

    Raises:
        DiffbotError: if a value is invalid, such as a depth that is not a number.
    """
    known = {name: value for name, value in plain.items() if name in Qos._fields}
    try:
        for name, words in _WORDS.items():
            if name in known:
                value = known[name]
                known[name] = words[range(len(words))[value] if isinstance(value, int) else words.index(value)]
        for name in _DURATIONS:
            if name in known:
                known[name] = _nanoseconds(known[name])
        known["depth"] = int(known.get("depth", 0))
        if not 0 <= known["depth"] < 2**64 or not isinstance(known.get("avoid_ros_namespace_conventions", False), bool):
            raise ValueError("depth")
    except (IndexError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise DiffbotError(f"{shown(dict(plain))} is not a QoS profile") from error
    return Qos(**known)


def _nanoseconds(duration: Mapping[str, int]) -> int:
    total = int(duration["sec"]) * 10**9 + int(duration["nsec"])
    # Foxy wrote 2147483647 s 4294967295 ns for an infinite duration.
    return INFINITE if total <= 0 or total >= 2147483647 * 10**9 else total


def dump_profiles(profiles: Sequence[Qos]) -> str:
    """Return the YAML text of channel metadata ``offered_qos_profiles``."""
    return yaml.safe_dump([to_plain(qos) for qos in profiles], sort_keys=False) if profiles else ""


def load_profiles(stored: Any) -> tuple[Qos, ...]:
    """Read ``offered_qos_profiles``: YAML text (channel, metadata.yaml up to version 8) or a list (version 9).

    Raises:
        DiffbotError: if it is neither.
    """
    profiles = load_yaml(stored, "offered_qos_profiles") if stored and isinstance(stored, str) else stored
    if not profiles:
        return ()
    if not isinstance(profiles, list) or not all(isinstance(item, Mapping) for item in profiles):
        raise DiffbotError(f"offered_qos_profiles is not a list of profiles: {shown(profiles)}")
    return tuple(from_plain(item) for item in profiles)


def to_request(offers: Sequence[Qos]) -> Qos:
    """Return the QoS of a subscription that is compatible with every offer and queues QUEUE_DEPTH messages.

    Request reliable delivery and transient local durability only if every publisher offers it.
    """
    reliable = bool(offers) and all(offer.reliability == "reliable" for offer in offers)
    latched = bool(offers) and all(offer.is_latched for offer in offers)
    return Qos(
        history="keep_last",
        depth=QUEUE_DEPTH,
        reliability="reliable" if reliable else "best_effort",
        durability="transient_local" if latched else "volatile",
    )


def to_offer(recorded: Sequence[Qos]) -> Qos:
    """Return the QoS of the one publisher that replaces all recorded publishers of a topic.

    Offer the strongest reliability and durability recorded, which every subscriber accepts; deadline, lifespan and
    liveliness only where all publishers agree. Discovery does not report the history: a latched topic keeps one message
    per original publisher, other topics keep QUEUE_DEPTH.
    """
    if not recorded:
        return Qos(history="keep_last", depth=QUEUE_DEPTH)
    agreed = recorded[0] if len(set(recorded)) == 1 else Qos()
    # The replay does not assert liveliness by hand, so a manual policy would be violated.
    automatic = agreed.liveliness == "automatic"
    latched = any(offer.is_latched for offer in recorded)
    depth = min(max(offer.depth for offer in recorded), MAX_DEPTH)
    return Qos(
        history="keep_last",
        depth=max(depth, len(recorded)) if latched else max(depth, QUEUE_DEPTH),
        reliability="best_effort" if all(one.reliability == "best_effort" for one in recorded) else "reliable",
        durability="transient_local" if latched else "volatile",
        deadline=agreed.deadline,
        lifespan=agreed.lifespan,
        liveliness_lease_duration=agreed.liveliness_lease_duration if automatic else INFINITE,
    )


def read_overrides(path: str, namespace: str = "/") -> dict[str, Qos]:
    """Read a file as of ``ros2 bag --qos-profile-overrides-path``; return the QoS by absolute topic name.

    Args:
        path: of a YAML file that maps topics to policies (the fields of Qos). Empty: no overrides.
        namespace: of relative topic names.

    Raises:
        DiffbotError: if the file cannot be read, or a topic, policy or value in it is not allowed.
    """
    if not path:
        return {}
    file = Path(path)
    content = load_yaml(read_text(file, MAX_FILE_SIZE), f"qos_profile_overrides_path = {shown(file)}")
    if not isinstance(content, Mapping) or not all(isinstance(topic, str) for topic in content):
        raise DiffbotError(f"{shown(file)}: must be a map of topic names to QoS policies")
    overrides = {}
    for topic, plain in content.items():
        try:
            overrides[absolute(topic, namespace)] = _override(plain)
        except DiffbotError as error:
            raise DiffbotError(f"{shown(file)}: {shown(topic)}: {error}") from error
    return overrides


def _override(plain: Any) -> Qos:
    if not isinstance(plain, Mapping):
        raise DiffbotError("must be a map of QoS policies")
    if unknown := [name for name in plain if name not in Qos._fields]:
        raise DiffbotError(f"{shown(unknown[0])!r}: must be one of {', '.join(Qos._fields)}")
    qos = from_plain({"history": "keep_last", "depth": QUEUE_DEPTH, **plain})
    if not 1 <= qos.depth <= MAX_DEPTH:
        raise InvalidValueError("depth", qos.depth, f">= 1 and <= {MAX_DEPTH}")
    for name in _WORDS:
        # Policies that discovery reports or resolves; an endpoint cannot be created with them.
        if getattr(qos, name) in ("unknown", "best_available"):
            raise InvalidValueError(name, getattr(qos, name), "a policy of a subscription")
    return qos


class TopicSelection(NamedTuple):
    """Topics by name and by regular expression of the whole name; if neither is given, all match. Exclusions win."""

    topics: Sequence[str] = ()
    regex: str = ""
    exclude_topics: Sequence[str] = ()
    exclude_regex: str = ""
    include_hidden_topics: bool = False

    def selects(self, topic: str) -> bool:
        """True if a topic (absolute name) is selected; a hidden one has to be named or included."""
        if topic in self.exclude_topics or (self.exclude_regex and re.fullmatch(self.exclude_regex, topic)):
            return False
        if topic in self.topics:
            return True
        if is_hidden(topic) and not self.include_hidden_topics:
            return False
        if self.regex:
            return re.fullmatch(self.regex, topic) is not None
        return not self.topics


def selection_of(config: Any, namespace: str, include_hidden_topics: bool) -> TopicSelection:
    """Return the selection by the parameters of a node (topics, regex, ...); relative names are of its namespace."""
    return TopicSelection(
        [absolute(name, namespace) for name in config.topics],
        config.regex,
        [absolute(name, namespace) for name in config.exclude_topics],
        config.exclude_regex,
        include_hidden_topics,
    )


def check_regex(**patterns: str) -> None:
    """Raise InvalidValueError, naming the parameter, if a regular expression is invalid."""
    for name, pattern in patterns.items():
        try:
            re.compile(pattern)
        except re.error as error:
            raise InvalidValueError(name, pattern, f"a regular expression ({error})") from error


def is_hidden(name: str) -> bool:
    """True if a part of the name of a topic or node begins with an underscore."""
    return "/_" in f"/{name}"


def absolute(topic: str, namespace: str = "/") -> str:
    """Return the absolute form of a topic name given in a namespace."""
    return topic if topic.startswith("/") else f"{namespace.rstrip('/')}/{topic}"
