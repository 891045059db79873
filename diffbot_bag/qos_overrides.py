"""QoS overrides by file, in the form of rosbag2's ``--qos-profile-overrides-path``: topic, policy, value.

::

    /scan:
      reliability: best_effort
      history: keep_last
      depth: 5
      deadline: {sec: 1, nsec: 0}

Policies that a topic does not name keep what the recorder or the replay has chosen.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diffbot_bag.bounded_yaml import MAX_CHARACTERS, load_yaml
from diffbot_bag.foreign_files import read_text, shown
from diffbot_bag.qos import INFINITE, MAX_DEPTH, Qos
from diffbot_bag.topic_selection import absolute
from diffbot_core.errors import DiffbotError, InvalidValueError

Overrides = Mapping[str, Mapping[str, Any]]
"""Fields of Qos by the absolute name of the topic."""
_WORDS = {
    "history": ("keep_last", "keep_all", "system_default"),
    "reliability": ("reliable", "best_effort", "best_available", "system_default"),
    "durability": ("transient_local", "volatile", "best_available", "system_default"),
    "liveliness": ("automatic", "manual_by_topic", "best_available", "system_default"),
}
_DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")


def read_overrides(path: Path, namespace: str = "/") -> Overrides:
    """Read a file of overrides; relative topic names are of ``namespace``.

    Raises:
        DiffbotError: if it cannot be read.
        InvalidValueError: naming topic and policy, if a value is not allowed.
    """
    content = load_yaml(read_text(path.expanduser(), MAX_CHARACTERS), shown(path))
    if content is None:
        return {}
    if not isinstance(content, dict) or not all(isinstance(policies, dict) for policies in content.values()):
        raise DiffbotError(f"{shown(path)}: must be topics with their policies, such as /scan: {{depth: 5}}")
    return {
        absolute(str(topic), namespace): {
            str(policy): _checked(f"{shown(path)}: {shown(topic)}.{shown(policy)}", policy, value)
            for policy, value in policies.items()
        }
        for topic, policies in content.items()
    }


def overridden(qos: Qos, topic: str, overrides: Overrides) -> Qos:
    """Return the profile of a topic with its overrides."""
    return qos._replace(**overrides.get(topic, {}))


def _checked(name: str, policy: Any, value: Any) -> Any:
    """Return the value of a policy as Qos holds it."""
    if policy not in Qos._fields:
        raise InvalidValueError(name, shown(value), f"a policy ({', '.join(Qos._fields)})")
    if policy in _DURATIONS:
        return _nanoseconds(name, value)
    if policy == "depth":
        if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= MAX_DEPTH:
            raise InvalidValueError(name, shown(value), f"a whole number, >= 1 and <= {MAX_DEPTH}")
    elif policy == "avoid_ros_namespace_conventions":
        if not isinstance(value, bool):
            raise InvalidValueError(name, shown(value), "true or false")
    elif value not in _WORDS[policy]:
        raise InvalidValueError(name, shown(value), f"one of {', '.join(_WORDS[policy])}")
    return value


def _nanoseconds(name: str, value: Any) -> int:
    parts = [value.get("sec"), value.get("nsec")] if isinstance(value, dict) and len(value) == 2 else []
    whole = [part for part in parts if isinstance(part, int) and not isinstance(part, bool) and part >= 0]
    if len(whole) != 2:
        raise InvalidValueError(name, shown(value), "{sec: whole number, nsec: whole number}, both >= 0")
    # Zero means no limit, as in rmw.
    return min(whole[0] * 10**9 + whole[1], INFINITE) or INFINITE
