"""Quality of service as plain values: rosbag2's YAML words, and the choice of QoS for recording and replay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from diffbot_core.bounded_yaml import dump_yaml, load_yaml
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import shown

INFINITE = 2**63 - 1
"""[ns] ROS's value of an infinite duration: 9223372036 s 854775807 ns"""
MAX_DEPTH = 1_000_000
"""Most messages that a replay keeps, whatever depth was recorded."""
REPLAY_DEPTH = 10_000
"""Messages kept per volatile topic in replay: DDS resends what a busy machine dropped only every 3 s."""
# Up to version 8, metadata.yaml holds policies as the integers of rmw.
_WORDS = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": (
        "system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available",
    ),
}  # fmt: skip
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
        """True if the publisher keeps its last messages for those who subscribe later."""
        return self.durability == "transient_local"


def to_plain(qos: Qos) -> dict[str, Any]:
    """Return the profile in the form of rosbag2's YAML."""
    plain: dict[str, Any] = qos._asdict()
    for name in _DURATIONS:
        sec, nsec = divmod(plain[name], 10**9)
        plain[name] = {"sec": sec, "nsec": nsec}
    return plain


def from_plain(plain: Mapping[str, Any]) -> Qos:
    """Read a profile written by any version of rosbag2; missing fields get their defaults, unknown ones are ignored.

    Raises:
        DiffbotError: if a value is invalid, such as a depth that is not a number.
    """
    known = {name: value for name, value in plain.items() if name in Qos._fields}
    try:
        for name, words in _WORDS.items():
            if name in known:
                known[name] = _word(known[name], words)
        for name in _DURATIONS:
            if name in known:
                known[name] = _nanoseconds(known[name])
        known["depth"] = int(known.get("depth", 0))
        if not 0 <= known["depth"] < 2**64 or not isinstance(known.get("avoid_ros_namespace_conventions", False), bool):
            raise ValueError("depth")
        return Qos(**known)
    except (IndexError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise DiffbotError(f"not a QoS profile: {shown(dict(plain))}") from error


def _word(value: Any, words: tuple[str, ...]) -> str:
    """Return a policy's word, which the value is or numbers."""
    number = value if isinstance(value, int) else words.index(value)
    if number < 0:
        raise IndexError(number)
    return words[number]


def _nanoseconds(duration: Mapping[str, int]) -> int:
    total = int(duration["sec"]) * 10**9 + int(duration["nsec"])
    # Foxy wrote 2147483647 s 4294967295 ns for an infinite duration.
    return INFINITE if total <= 0 or total >= 2147483647 * 10**9 else total


def dump_profiles(profiles: Sequence[Qos]) -> str:
    """Return the YAML text of channel metadata ``offered_qos_profiles``."""
    return dump_yaml([to_plain(qos) for qos in profiles]) if profiles else ""


def load_profiles(stored: Any) -> tuple[Qos, ...]:
    """Read ``offered_qos_profiles``: YAML text (channel, metadata.yaml to version 8) or a list (version 9).

    Raises:
        DiffbotError: if it is neither.
    """
    # Most topics have no profiles, and opening a bag reads those of all topics: no YAML parser for an empty text.
    profiles = load_yaml(stored, "offered_qos_profiles") if stored and isinstance(stored, str) else stored
    if not profiles:
        return ()
    if not isinstance(profiles, list) or not all(isinstance(item, Mapping) for item in profiles):
        raise DiffbotError(f"offered_qos_profiles is not a list of profiles: {shown(profiles)}")
    return tuple(from_plain(item) for item in profiles)


def to_request(offers: Sequence[Qos], depth: int) -> Qos:
    """Return the QoS of a subscription that is compatible with every offer and queues ``depth`` messages.

    Reliable and transient local only where every publisher offers it; nothing else is requested.
    """
    reliable = bool(offers) and all(offer.reliability == "reliable" for offer in offers)
    latched = bool(offers) and all(offer.is_latched for offer in offers)
    return Qos(
        history="keep_last",
        depth=depth,
        reliability="reliable" if reliable else "best_effort",
        durability="transient_local" if latched else "volatile",
    )


def to_offer(recorded: Sequence[Qos]) -> Qos:
    """Return the QoS of the one publisher that replaces all recorded publishers of a topic.

    It offers the strongest reliability and durability recorded, which every subscriber accepts; deadline, lifespan and
    liveliness only where all publishers agree. Discovery does not report the history: a latched topic keeps one message
    per original publisher, other topics keep REPLAY_DEPTH.
    """
    if not recorded:
        return Qos(history="keep_last", depth=REPLAY_DEPTH)
    agreed = recorded[0] if len(set(recorded)) == 1 else Qos()
    # The replay does not assert liveliness by hand, so a manual policy would be violated.
    by_itself = agreed.liveliness == "automatic"
    latched = any(offer.is_latched for offer in recorded)
    known_depth = min(max(offer.depth for offer in recorded), MAX_DEPTH)
    return Qos(
        history="keep_last",
        depth=max(known_depth, len(recorded)) if latched else max(known_depth, REPLAY_DEPTH),
        reliability="best_effort" if all(o.reliability == "best_effort" for o in recorded) else "reliable",
        durability="transient_local" if latched else "volatile",
        deadline=agreed.deadline,
        lifespan=agreed.lifespan,
        liveliness="automatic",
        liveliness_lease_duration=agreed.liveliness_lease_duration if by_itself else INFINITE,
    )
