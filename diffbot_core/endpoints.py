"""Publishers and subscriptions of one topic: if they match, and in words what to do if they do not. Free of ROS."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple


class Endpoint(NamedTuple):
    """A publisher or a subscription."""

    node: str
    """full name of its node"""
    type: str
    """of its messages, e.g. ``geometry_msgs/msg/Twist``"""
    is_reliable: bool = True
    """a publisher offers reliable delivery, a subscription requests it"""
    is_latched: bool = False
    """a publisher offers transient local durability, a subscription requests it"""

    @property
    def short_type(self) -> str:
        """The type without its package: ``Twist`` of ``geometry_msgs/msg/Twist``."""
        return self.type.rpartition("/")[2]


def qos_mismatch(publisher: Endpoint, subscription: Endpoint) -> tuple[str, str]:
    """Return the policy that keeps messages from a subscription, and what it requests; two empty texts if none does."""
    if subscription.is_reliable and not publisher.is_reliable:
        return "reliability", "reliable"
    is_late = subscription.is_latched and not publisher.is_latched
    return ("durability", "transient_local") if is_late else ("", "")


def input_problem(topic: str, own: Endpoint, publishers: Sequence[Endpoint], elsewhere: Collection[str] = ()) -> str:
    """Return why nothing can arrive at a subscription from any publisher of its topic; empty if one matches.

    ``elsewhere`` are other topics of the same type that are published, and that the node does not use.
    """
    others = " to " + " or ".join(sorted(elsewhere)[:_MAX_OTHERS]) if elsewhere else ""
    problem = f"nothing publishes {topic}: start its source, or remap {topic}{others}"
    name = topic.rpartition("/")[2]
    if same_name := [other for other in sorted(elsewhere) if other.endswith(f"/{name}")]:
        namespace = same_name[0].removesuffix(f"/{name}") or "/"
        remedy = f"run all nodes in the namespace {namespace}, or remap {topic} to {same_name[0]}"
        problem = f"nothing publishes {topic}: {remedy}"
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


OBSERVERS = (
    "_ros2cli",
    "rosbag2_",
    "recorder",
    "watch",
    "rviz",
    "rqt",
    "foxglove_bridge",
    "plotjuggler",
    "diffbot_check",
)
"""Beginnings of the names of nodes that subscribe to look on, and drive nothing."""
_MAX_OTHERS = 3
"""topics that are listed as an alternative"""
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
TYPE_WORDS = {TWIST: "twist", TWIST_STAMPED: "twist_stamped"}
AUTO = "auto"
"""Values of the parameter cmd_vel_type: the types, and the one that the base subscribes to."""


def is_observer(node: str) -> bool:
    """Return True if a node, given by its full name, subscribes to look on only."""
    return node.rpartition("/")[2].startswith(OBSERVERS)


def bases(subscriptions: Sequence[Endpoint]) -> list[Endpoint]:
    """Return the subscriptions to cmd_vel that may drive a robot: those of other nodes than observers."""
    return [one for one in subscriptions if not is_observer(one.node)]


def followed_type(present: str, subscriptions: Sequence[Endpoint]) -> str:
    """Return the type that commands should have: the subscriptions', or the present one if these do not agree."""
    types = {one.type for one in bases(subscriptions) if one.type in TYPE_WORDS}
    return types.pop() if len(types) == 1 else present


def command_problem(topic: str, own: Endpoint, subscriptions: Sequence[Endpoint], elsewhere: Collection[str]) -> str:
    """Return which subscription to cmd_vel gets no commands, or that there is none; empty if all get them.

    ``own`` is the publisher; ``elsewhere`` are other topics of commands, which have subscriptions.
    """
    found = bases(subscriptions)
    if not found:
        observers = ", ".join(sorted({one.node for one in subscriptions}))
        nobody = f"nobody but {observers} subscribes to {topic}" if observers else f"nobody subscribes to {topic}"
        others = f", or remap cmd_vel to {' or '.join(sorted(elsewhere))}" if elsewhere else ""
        return f"{nobody}: start the driver of the base{others}"
    for one in found:
        policy, request = qos_mismatch(own, one)
        if one.type != own.type:
            word = TYPE_WORDS.get(one.type)
            remedy = f"set cmd_vel_type to {word}" if word else "give it Twist or TwistStamped"
            return f"{one.node} subscribes to {topic} as {one.short_type}, the commands are {own.short_type}: {remedy}"
        if policy:
            parameter = f"qos_overrides.{topic}.publisher.{policy}"
            return f"{one.node} requests {request} {policy} of {topic}: set {parameter} to {request}"
    return ""
