"""Quality of service: the profiles of this project, and their overrides by parameters as rclpy names them.

A subscription that asks for reliable delivery gets nothing from a best-effort publisher, while best effort accepts
both. So sensors are received best effort, unless every message is needed, as in lock-step.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from diffbot_core.schema import Parameter, Spec, checked

QUEUE = QoSProfile(depth=10)
"""Reliable and volatile: the default of publishers and subscriptions."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Transient local: late subscribers receive the last message."""
STATUS = QoSProfile(
    depth=1,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=Duration(seconds=1),
)
"""Latched, with a lease: a subscriber that asks for it learns within a second that the process has died."""
SENSOR = QoSProfile(depth=20, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Of subscriptions: accepts any publisher; deep enough for 0.1 s at 200 Hz, more than rclpy's 5 for sensors."""
TRANSFORMS = QoSProfile(depth=100)
"""Of /tf, as tf2_ros publishes it."""

PUBLISHER, SUBSCRIPTION = "publisher", "subscription"
_KINDS = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY)
_POLICIES: dict[str, tuple[type, Spec]] = {
    "history": (str, Spec("", choices=("keep_last", "keep_all", "system_default"))),
    "depth": (int, Spec("", minimum=1, maximum=1_000_000)),
    "reliability": (str, Spec("", choices=("reliable", "best_effort", "best_available", "system_default"))),
    "durability": (str, Spec("", choices=("volatile", "transient_local", "best_available", "system_default"))),
}
"""What may be overridden, with the values allowed."""


def sensor_qos(reliable: bool) -> QoSProfile:
    """Return the profile of a sensor's subscription; ``reliable`` excludes best-effort publishers."""
    return QUEUE if reliable else SENSOR


def overridable(profile: QoSProfile | int) -> tuple[QoSProfile, QoSOverridingOptions]:
    """Return a profile that rclpy may change, and the options by which it does."""
    profile = QoSProfile(depth=profile) if isinstance(profile, int) else copy(profile)
    return profile, QoSOverridingOptions(_KINDS)


def check_overrides(overrides: Mapping[str, Any], topic: str, entity: str) -> None:
    """Check the parameters ``qos_overrides.TOPIC.ENTITY.POLICY`` of a topic before rclpy uses them.

    Args:
        overrides: parameters given from outside, by name.
        topic: its full name, remapped.
        entity: PUBLISHER or SUBSCRIPTION.

    Raises:
        InvalidValueError: naming parameter, value and what is allowed.
    """
    for policy, (kind, spec) in _POLICIES.items():
        name = f"qos_overrides.{topic}.{entity}.{policy}"
        if name in overrides:
            checked(Parameter(name, (), kind, None, spec), overrides[name])
