"""Convert QoS profiles to and from ROS, and import the classes of message types."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from diffbot_bag.definitions import interface_prefixes, split_type_name
from diffbot_bag.qos import INFINITE, Qos
from diffbot_core.errors import DiffbotError, shown


def from_ros(profile: QoSProfile) -> Qos:
    """Convert a profile of ROS, in which a zero duration means no limit."""
    return Qos(
        history=profile.history.name.lower(),
        depth=profile.depth,
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        deadline=profile.deadline.nanoseconds or INFINITE,
        lifespan=profile.lifespan.nanoseconds or INFINITE,
        liveliness=profile.liveliness.name.lower(),
        liveliness_lease_duration=profile.liveliness_lease_duration.nanoseconds or INFINITE,
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def to_ros(qos: Qos) -> QoSProfile:
    """Convert a profile to ROS; infinite durations are left at the defaults of QoSProfile."""
    durations = {
        name: Duration(nanoseconds=value)
        for name in ("deadline", "lifespan", "liveliness_lease_duration")
        if (value := getattr(qos, name)) < INFINITE
    }
    return QoSProfile(
        history=HistoryPolicy[qos.history.upper()],
        depth=qos.depth,
        reliability=ReliabilityPolicy[qos.reliability.upper()],
        durability=DurabilityPolicy[qos.durability.upper()],
        liveliness=LivelinessPolicy[qos.liveliness.upper()],
        avoid_ros_namespace_conventions=qos.avoid_ros_namespace_conventions,
        **durations,
    )


def offers(publishers: list[TopicEndpointInfo]) -> tuple[Qos, ...]:
    """Return the QoS that each publisher of a topic offers."""
    return tuple(from_ros(publisher.qos_profile) for publisher in publishers)


def type_hash(publishers: list[TopicEndpointInfo]) -> str:
    """Return the type hash that the publishers report; empty if it is unknown."""
    hashes = (str(publisher.topic_type_hash) for publisher in publishers)
    return next((text for text in hashes if text != "INVALID"), "")


def message_class(type_name: str) -> Any:
    """Import the Python class of ``pkg/msg/Type``.

    An import runs code, and the name may come from an untrusted bag or publisher. So only packages that an ament index
    lists are imported, and only from the prefix of that index.

    Raises:
        DiffbotError: if the type is not installed or cannot be loaded.
    """
    package, kind, name = split_type_name(type_name)
    prefixes = interface_prefixes(package)
    try:
        origin = getattr(importlib.util.find_spec(package), "origin", None) if prefixes else None
        # Accept the path and the target of a link: `colcon build --symlink-install` installs links.
        places = [Path(origin), Path(origin).resolve()] if origin else []
        roots = [*prefixes, *(prefix.resolve() for prefix in prefixes)]
        if not any(place.is_relative_to(root) for place in places for root in roots):
            raise ImportError("not an installed package with interfaces")
        found = getattr(importlib.import_module(f"{package}.{kind}"), name)
        # Load the C library of the class, which may be missing.
        type(found).__import_type_support__()
    except (ImportError, AttributeError, ValueError) as error:
        raise DiffbotError(f"type {shown(type_name)} is not installed") from error
    except Exception as error:  # the exceptions of rosidl do not share a base class
        raise DiffbotError(f"type {type_name} cannot be loaded: {error}") from error
    return found
