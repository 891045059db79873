"""QoS profiles without ROS, with the names of rosbag2's YAML.

A bag stores the profile that each publisher of a topic offered. The recorder subscribes with a profile that is
compatible with all offers. The replay publishes with one profile that replaces all recorded publishers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import yaml

from diffbot_bag.topic_selection import absolute
from diffbot_core.errors import DiffbotError, InvalidValueError, shown
from diffbot_core.files import expanded, read_text
from diffbot_core.yaml_files import load_yaml

INFINITE = 2**63 - 1
"""[ns] value of an infinite duration in ROS: 9223372036 s 854775807 ns"""
QUEUE_DEPTH = 10_000
"""Queue depth of the recorder's subscriptions and of the publishers of volatile topics in a replay."""
MAX_DEPTH = 1_000_000
MAX_FILE_SIZE = 2**20
"""[bytes] largest file with QoS overrides"""
# Up to version 8, metadata.yaml stores each policy as an integer of rmw, the index in these lists.
_POLICIES = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": ("system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available"),
}
_DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")


class Qos(NamedTuple):
    """A QoS profile; durations in [ns], INFINITE for no limit."""

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
        """True if a publisher with this profile keeps its last messages for late subscribers."""
        return self.durability == "transient_local"


def to_plain(qos: Qos) -> dict[str, Any]:
    """Convert a profile to the map that rosbag2 writes as YAML."""
    plain: dict[str, Any] = qos._asdict()
    for name in _DURATIONS:
        sec, nsec = divmod(plain[name], 10**9)
        plain[name] = {"sec": sec, "nsec": nsec}
    return plain


def from_plain(plain: Mapping[str, Any]) -> Qos:
    """Read a profile of any version of rosbag2. Missing fields get their defaults, unknown fields are ignored.

    Raises:
        DiffbotError: if the value of a field is not allowed.
    """
    fields: dict[str, Any] = {}
    for name in Qos._fields:
        if name not in plain:
            continue
        try:
            fields[name] = _read_field(name, plain[name])
        except (LookupError, TypeError, ValueError, OverflowError) as error:
            raise DiffbotError(f"{name} = {shown(plain[name])} is not allowed in a QoS profile") from error
    return Qos(**fields)


def _read_field(name: str, value: Any) -> Any:
    """Convert the value of one field; raise an error of any type if it is not allowed."""
    if policies := _POLICIES.get(name):
        return policies[range(len(policies))[value] if isinstance(value, int) else policies.index(value)]
    if name in _DURATIONS:
        duration = int(value["sec"]) * 10**9 + int(value["nsec"])
        # Foxy wrote 2147483647 s 4294967295 ns for an infinite duration.
        return INFINITE if duration <= 0 or duration >= 2147483647 * 10**9 else duration
    if name == "depth" and 0 <= int(value) < 2**64:
        return int(value)
    if name == "avoid_ros_namespace_conventions" and isinstance(value, bool):
        return value
    raise ValueError(name)


def dump_profiles(profiles: Sequence[Qos]) -> str:
    """Return the YAML text for ``offered_qos_profiles`` in the metadata of an MCAP channel."""
    return yaml.safe_dump([to_plain(qos) for qos in profiles], sort_keys=False) if profiles else ""


def load_profiles(stored: Any) -> tuple[Qos, ...]:
    """Read ``offered_qos_profiles``: a list (metadata.yaml version 9) or YAML text (earlier versions, MCAP channels).

    Raises:
        DiffbotError: if it is not a list of QoS profiles.
    """
    profiles = load_yaml(stored, "offered_qos_profiles") if stored and isinstance(stored, str) else stored
    if not profiles:
        return ()
    if not isinstance(profiles, list) or not all(isinstance(item, Mapping) for item in profiles):
        raise DiffbotError(f"offered_qos_profiles = {shown(profiles)}: must be a list of QoS profiles")
    return tuple(from_plain(item) for item in profiles)


def to_request(offers: Sequence[Qos]) -> Qos:
    """Return the QoS of a subscription that is compatible with every offer.

    It requests reliable delivery or transient local durability only if every publisher offers it.
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

    It offers the strongest reliability and durability that were recorded, which every subscriber accepts. It offers
    deadline, lifespan and liveliness only if all recorded profiles are equal. The recorded depth is often 0, because
    discovery does not report it. So a latched topic keeps at least one message for each recorded publisher, and other
    topics keep at least QUEUE_DEPTH messages.
    """
    if not recorded:
        return Qos(history="keep_last", depth=QUEUE_DEPTH)
    agreed = recorded[0] if len(set(recorded)) == 1 else Qos()
    # The replay does not assert its liveliness, as a manual policy requires.
    automatic = agreed.liveliness == "automatic"
    latched = any(offer.is_latched for offer in recorded)
    depth = min(max(offer.depth for offer in recorded), MAX_DEPTH)
    return Qos(
        history="keep_last",
        depth=max(depth, len(recorded)) if latched else max(depth, QUEUE_DEPTH),
        reliability="best_effort" if all(offer.reliability == "best_effort" for offer in recorded) else "reliable",
        durability="transient_local" if latched else "volatile",
        deadline=agreed.deadline,
        lifespan=agreed.lifespan,
        liveliness_lease_duration=agreed.liveliness_lease_duration if automatic else INFINITE,
    )


def read_overrides(path: str, namespace: str = "/") -> dict[str, Qos]:
    """Read a file of QoS overrides, with the format of ``ros2 bag --qos-profile-overrides-path``.

    Args:
        path: YAML file that maps topics to policies (the fields of Qos). Empty: there are no overrides.
        namespace: namespace of relative topic names.

    Returns:
        QoS by absolute topic name.

    Raises:
        DiffbotError: if the file cannot be read, or a policy or its value is not allowed.
    """
    if not path:
        return {}
    file = expanded(path)
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
        raise DiffbotError(f"{shown(unknown[0])!r} is not a QoS policy: must be one of {', '.join(Qos._fields)}")
    qos = from_plain({"history": "keep_last", "depth": QUEUE_DEPTH, **plain})
    if not 1 <= qos.depth <= MAX_DEPTH:
        raise InvalidValueError("depth", qos.depth, f">= 1 and <= {MAX_DEPTH}")
    for name, policies in _POLICIES.items():
        # Discovery reports these values, but an endpoint cannot be created with them.
        if (value := getattr(qos, name)) in ("unknown", "best_available"):
            allowed = [policy for policy in policies if policy not in ("unknown", "best_available")]
            raise InvalidValueError(name, value, f"one of {', '.join(allowed)}")
    return qos
