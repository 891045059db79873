"""Conversions between ROS and this package: QoS profiles, message types, and the data of raw subscriptions."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo

from diffbot_bag.bag.message_definitions import interface_prefixes, split_type_name
from diffbot_bag.bag.qos import INFINITE, Qos
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import shown


def from_ros(profile: QoSProfile) -> Qos:
    """Return a profile in rosbag2's words; a duration of zero means no limit."""
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
    """Return the profile for a publisher or subscription; an INFINITE duration is left at the default of ROS."""
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
    """Return the type hash that the publishers report; empty if they report none."""
    hashes = (str(publisher.topic_type_hash) for publisher in publishers)
    return next((text for text in hashes if text != "INVALID"), "")


def message_class(type_name: str) -> Any:
    """Import the Python class of ``pkg/msg/Type``.

    The name may come from a bag or a publisher of unknown origin, and an import runs code: only packages with
    interfaces are imported, and only from the prefix whose ament index has them.

    Raises:
        DiffbotError: if the type is not installed.
    """
    package, kind, name = split_type_name(type_name)
    prefixes = interface_prefixes(package)
    try:
        origin = getattr(importlib.util.find_spec(package), "origin", None) if prefixes else None
        if origin is None or not any(_contains(prefix, Path(origin)) for prefix in prefixes):
            raise ImportError("not an installed package with interfaces")
        found = getattr(importlib.import_module(f"{package}.{kind}"), name)
        # Loads the C library behind the class, which may be missing.
        type(found).__import_type_support__()
    except (ImportError, AttributeError, ValueError) as error:
        raise DiffbotError(f"type {shown(type_name)} is not installed") from error
    except Exception as error:  # the exceptions of rosidl have no common base class
        raise DiffbotError(f"type {type_name} cannot be loaded: {error}") from error
    return found


def _contains(prefix: Path, origin: Path) -> bool:
    # As it is found, and as it is: builds with symbolic links install links.
    return origin.is_relative_to(prefix) or origin.resolve().is_relative_to(prefix.resolve())


def with_info(callback: Callable[[bytes, dict[str, Any]], None]) -> Callable[..., None]:
    """Wrap a callback of message and info for every executor of rclpy.

    Executors pass two arguments, except for the EventsExecutor of rclpy 7.1.6, which passes one pair.
    """

    def adapted(data: Any, info: Any = None) -> None:
        if info is None:
            data, info = data
        callback(data, info)

    # rclpy inspects the signature to find out whether to pass the info.
    adapted.__signature__ = inspect.signature(callback)  # type: ignore[attr-defined]
    return adapted


def take_pending(subscription: Any) -> tuple[bytes, dict[str, Any]] | None:
    """Take a received message that no executor has taken yet, with its info; None if there is none."""
    with subscription.handle:
        taken: tuple[bytes, dict[str, Any]] | None = subscription.handle.take_message(subscription.msg_type, True)
    return taken
