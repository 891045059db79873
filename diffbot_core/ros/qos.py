"""Quality of service: profiles, overrides by parameters, and delivery of a node's last message.

A reliable subscription does not receive messages of a best-effort publisher, while a best-effort subscription receives
messages of both kinds. So subscriptions to sensors are best effort, unless every message is needed, as in lock-step.
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
"""Transient local: a late subscriber receives the last message."""
STATUS = QoSProfile(
    depth=1,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=Duration(seconds=1),
)
"""Latched, with a liveliness lease of 1 s, after which DDS reports the end of the process to subscribers."""
SENSOR = QoSProfile(depth=20, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Subscriptions to sensors: matches any publisher, and queues 0.1 s of messages at 200 Hz."""
TRANSFORMS = QoSProfile(depth=100)
"""Publishers of and subscriptions to /tf, as in tf2_ros."""
STATIC_TRANSFORMS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Subscriptions to /tf_static, which has several publishers."""

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
"""[s] Longest time to wait until reliable readers acknowledge a last message; a suspended reader never does."""
REPEATS = 6
"""Number of times that a last message is published for best-effort readers, which do not acknowledge it."""
_RESEND_PERIOD = 0.1
"""[s] Time after which an unacknowledged message is published again; the middleware waits 3 s."""
_REPEAT_PERIOD = 0.05
"""[s] Time between two messages to best-effort readers."""


def sensor_qos(reliable: bool) -> QoSProfile:
    """Return the profile of a subscription to a sensor; ``reliable`` excludes best-effort publishers."""
    return QUEUE if reliable else SENSOR


def overridable(
    profile: QoSProfile | int, overrides: Mapping[str, Any], topic: str, entity: str
) -> tuple[QoSProfile, QoSOverridingOptions]:
    """Return a profile, and the rclpy option for the parameters ``qos_overrides.TOPIC.ENTITY.POLICY``.

    The overrides are checked here, because the error of rclpy for a wrong word does not name the parameter.

    Args:
        profile: the default profile, or its depth.
        overrides: the given parameters by name.
        topic: full name of the topic after remapping.
        entity: PUBLISHER or SUBSCRIPTION.

    Raises:
        InvalidValueError: if the value of an override is not allowed.
    """
    for policy, (kind, spec) in _POLICIES.items():
        name = f"qos_overrides.{topic}.{entity}.{policy}"
        if name in overrides:
            checked(Parameter(name, (), kind, None, spec), overrides[name])
    profile = QoSProfile(depth=profile) if isinstance(profile, int) else copy(profile)
    return profile, QoSOverridingOptions(_KINDS)


def deliver(node: Node, publisher: Any, publish: Callable[[], None]) -> bool:
    """Publish a message repeatedly until all readers should have it; return True if all reliable readers confirmed it.

    This function returns after at most DELIVERY_TIMEOUT. It does not need an executor.

    Args:
        node: node of the publisher.
        publisher: the publisher that ``publish`` uses.
        publish: publishes the message once.
    """
    deadline = time.monotonic() + DELIVERY_TIMEOUT
    topic = publisher.topic_name
    ends = [*node.get_subscriptions_info_by_topic(topic), *node.get_publishers_info_by_topic(topic)]
    best_effort = any(end.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for end in ends)
    remaining = REPEATS if best_effort else 1
    while True:
        publish()
        remaining -= 1
        acknowledged = bool(publisher.wait_for_all_acked(Duration(seconds=_RESEND_PERIOD)))
        if (acknowledged and remaining <= 0) or time.monotonic() >= deadline:
            return acknowledged
        if acknowledged:
            time.sleep(_REPEAT_PERIOD)
