"""Quality of service: the profiles of this project, their overrides by parameters, and delivery of a last message.

A subscription that asks for reliable delivery gets nothing from a best-effort publisher, while best effort accepts
both. So sensors are received best effort, unless every message is needed, as in lock-step.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from copy import copy
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

from diffbot_core.schema import Parameter, Spec, checked

QUEUE = QoSProfile(depth=10)
"""Default of publishers and subscriptions: reliable and volatile."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Transient local: late subscribers receive the last message."""
STATUS = QoSProfile(
    depth=1,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=Duration(seconds=1),
)
"""Latched, with a lease: DDS reports to a subscriber that requests it, within a second, that the process has died."""
SENSOR = QoSProfile(depth=20, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Of subscriptions to sensors: accepts any publisher, and queues 0.1 s at 200 Hz (rclpy's own profile queues 5)."""
TRANSFORMS = QoSProfile(depth=100)
"""Of /tf, as tf2_ros publishes it."""
STATIC_TRANSFORMS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Of subscriptions to /tf_static: latched, for one or more messages of each publisher."""

PUBLISHER, SUBSCRIPTION = "publisher", "subscription"
_WORDS = {"history": HistoryPolicy, "reliability": ReliabilityPolicy, "durability": DurabilityPolicy}
_KINDS = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY)
_POLICIES: dict[str, tuple[type, Spec]] = {
    "depth": (int, Spec("", minimum=1, maximum=1_000_000)),
    **{
        name: (str, Spec("", choices=tuple(one.name.lower() for one in words if one.name != "UNKNOWN")))
        for name, words in _WORDS.items()
    },
}
"""Policies that parameters may override, and the allowed values."""

DELIVERY_TIMEOUT = 1.0
"""[s] time to wait until reliable readers acknowledge a last message; a suspended reader must not block the node"""
REPEATS = 6
"""number of times a last message is published if delivery is best effort, which readers do not acknowledge"""
_RESEND_PERIOD = 0.1
"""[s] time after which a message without acknowledgement is published again; the middleware repeats it after 3 s"""
_REPEAT_PERIOD = 0.05


def sensor_qos(reliable: bool) -> QoSProfile:
    """Return the profile of a sensor's subscription; ``reliable`` excludes best-effort publishers."""
    return QUEUE if reliable else SENSOR


def overridable(
    profile: QoSProfile | int, overrides: Mapping[str, Any], topic: str, entity: str
) -> tuple[QoSProfile, QoSOverridingOptions]:
    """Return a profile that rclpy may change by parameters ``qos_overrides.TOPIC.ENTITY.POLICY``, and its options.

    Args:
        profile: the default, or its depth.
        overrides: parameters given from outside, by name. They are checked here, since rclpy's own error for a wrong
            word does not name the parameter.
        topic: its full name, remapped.
        entity: PUBLISHER or SUBSCRIPTION.

    Raises:
        InvalidValueError: naming parameter, value and what is allowed.
    """
    for policy, (kind, spec) in _POLICIES.items():
        name = f"qos_overrides.{topic}.{entity}.{policy}"
        if name in overrides:
            checked(Parameter(name, (), kind, None, spec), overrides[name])
    profile = QoSProfile(depth=profile) if isinstance(profile, int) else copy(profile)
    return profile, QoSOverridingOptions(_KINDS)


def deliver(node: Node, publisher: Any, publish: Callable[[], None]) -> bool:
    """Call ``publish`` until each matched reader has a message; return True if all reliable readers have confirmed it.

    This takes DELIVERY_TIMEOUT at most, and needs no executor.

    Args:
        node: node of the publisher.
        publisher: what ``publish`` publishes with.
        publish: publishes the message.
    """
    deadline = time.monotonic() + DELIVERY_TIMEOUT
    topic = publisher.topic_name
    ends = [*node.get_subscriptions_info_by_topic(topic), *node.get_publishers_info_by_topic(topic)]
    best_effort = any(end.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for end in ends)
    due = REPEATS if best_effort else 1
    while True:
        publish()
        due -= 1
        acknowledged = bool(publisher.wait_for_all_acked(Duration(seconds=_RESEND_PERIOD)))
        if (acknowledged and due <= 0) or time.monotonic() >= deadline:
            return acknowledged
        if acknowledged:
            time.sleep(_REPEAT_PERIOD)
