"""Find mismatches of publishers and subscriptions of a topic, and describe how to fix them. Does not need ROS."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

OBSERVERS = (
    *("_ros2cli", "rosbag2_", "recorder", "watch", "rviz", "rqt", "foxglove_bridge", "plotjuggler"),
    "diffbot_check",
)
"""Prefixes of the names of nodes that subscribe to cmd_vel and do not drive a robot."""
_MAX_OTHERS = 3
"""Largest number of topics that are listed as alternatives."""
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
TYPE_WORDS = {TWIST: "twist", TWIST_STAMPED: "twist_stamped"}
"""Values of the parameter cmd_vel_type by message type."""
AUTO = "auto"
"""Value of cmd_vel_type that selects the type to which the base subscribes."""


class Endpoint(NamedTuple):
    """A publisher or a subscription."""

    node: str
    """full name of its node"""
    type: str
    """of its messages, e.g. ``geometry_msgs/msg/Twist``"""
    is_reliable: bool = True
    """the publisher offers reliable delivery, or the subscription requests it"""
    is_latched: bool = False
    """the publisher offers transient local durability, or the subscription requests it"""

    @property
    def short_type(self) -> str:
        """The type without its package: ``Twist`` of ``geometry_msgs/msg/Twist``."""
        return self.type.rpartition("/")[2]


def qos_mismatch(publisher: Endpoint, subscription: Endpoint) -> tuple[str, str]:
    """Return the QoS policy that does not match and the value that is requested; two empty texts if all match."""
    if subscription.is_reliable and not publisher.is_reliable:
        return "reliability", "reliable"
    if subscription.is_latched and not publisher.is_latched:
        return "durability", "transient_local"
    return "", ""


def input_problem(topic: str, own: Endpoint, publishers: Sequence[Endpoint], elsewhere: Collection[str] = ()) -> str:
    """Return why the subscription ``own`` receives no messages; empty if a publisher matches.

    ``elsewhere`` are published topics of the same type to which the node does not subscribe.
    """
    if not publishers:
        name = topic.rpartition("/")[2]
        for other in sorted(elsewhere):
            if other.endswith(f"/{name}"):
                namespace = other.removesuffix(f"/{name}") or "/"
                remedy = f"run all nodes in the namespace {namespace}, or remap {topic} to {other}"
                return f"nothing publishes {topic}: {remedy}"
        others = " to " + " or ".join(sorted(elsewhere)[:_MAX_OTHERS]) if elsewhere else ""
        return f"nothing publishes {topic}: start its source, or remap {topic}{others}"
    problem = ""
    for one in publishers:
        policy, request = qos_mismatch(one, own)
        if one.type != own.type:
            problem = f"{one.node} publishes {topic} as {one.short_type}: convert it to {own.short_type}"
        elif policy:
            remedy = f"change the {policy} of one of them"
            problem = f"{one.node} does not publish {topic} as {request}, which {own.node} requests: {remedy}"
        else:
            return ""
    return problem


def is_observer(node: str) -> bool:
    """Return True if a node, given by its full name, only observes topics."""
    return node.rpartition("/")[2].startswith(OBSERVERS)


def bases(subscriptions: Sequence[Endpoint]) -> list[Endpoint]:
    """Return the subscriptions to cmd_vel of nodes that may drive a robot, which are all nodes but the observers."""
    return [one for one in subscriptions if not is_observer(one.node)]


def followed_type(present: str, subscriptions: Sequence[Endpoint]) -> str:
    """Return the type to which the bases subscribe; the ``present`` type if they do not agree on one."""
    types = {one.type for one in bases(subscriptions) if one.type in TYPE_WORDS}
    return types.pop() if len(types) == 1 else present


def command_problem(topic: str, own: Endpoint, subscriptions: Sequence[Endpoint], elsewhere: Collection[str]) -> str:
    """Return why a base does not receive the commands of the publisher ``own``; empty if all bases receive them.

    ``elsewhere`` are other topics of commands to which nodes subscribe.
    """
    found = bases(subscriptions)
    if not found:
        observers = ", ".join(sorted({one.node for one in subscriptions}))
        only = f", only {observers}" if observers else ""
        others = f", or remap cmd_vel to {' or '.join(sorted(elsewhere))}" if elsewhere else ""
        return f"no base subscribes to {topic}{only}: start the driver of the base{others}"
    for one in found:
        policy, request = qos_mismatch(own, one)
        if one.type != own.type:
            word = TYPE_WORDS.get(one.type)
            remedy = f"set cmd_vel_type to {word}" if word else "change its type to Twist or TwistStamped"
            mismatch = f"subscribes to {topic} as {one.short_type}, but the commands are {own.short_type}"
            return f"{one.node} {mismatch}: {remedy}"
        if policy:
            parameter = f"qos_overrides.{topic}.publisher.{policy}"
            return f"{one.node} requests {request} {policy} of {topic}: set {parameter} to {request}"
    return ""
