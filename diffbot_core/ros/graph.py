"""Queries of the ROS graph: publishers and subscriptions of topics, and topics of a type."""

from __future__ import annotations

from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from diffbot_core.endpoints import TYPE_WORDS, Endpoint, bases


def publisher_names(node: Node, topic: str) -> list[str]:
    """Return the full names of the nodes that publish a topic, sorted, one for each publisher."""
    return sorted(one.node for one in publishers_of(node, topic))


def publishers_of(node: Node, topic: str) -> list[Endpoint]:
    """Return the publishers of a topic, given by its full name."""
    return _endpoints(node, topic, rclpy_implementation.rclpy_get_publishers_info_by_topic)


def subscriptions_of(node: Node, topic: str) -> list[Endpoint]:
    """Return the subscriptions to a topic, given by its full name."""
    return _endpoints(node, topic, rclpy_implementation.rclpy_get_subscriptions_info_by_topic)


def _endpoints(node: Node, topic: str, find: Any) -> list[Endpoint]:
    # The methods of Node remap the topic, so a remapped node could not look at the original topic.
    with node.handle:
        infos = [TopicEndpointInfo(**one) for one in find(node.handle, topic, False)]
    return [
        Endpoint(
            full_name(info),
            info.topic_type,
            info.qos_profile.reliability == ReliabilityPolicy.RELIABLE,
            info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        )
        for info in infos
    ]


def published_elsewhere(node: Node, topic: str, kind: str) -> list[str]:
    """Return other topics of the type ``kind`` that other nodes publish and to which ``node`` does not subscribe.

    The topic initialpose, on which RViz publishes, is left out.
    """
    own = {one.topic_name for one in node.subscriptions} | {node.resolve_topic_name("initialpose")}
    name = node.get_fully_qualified_name()
    found = [one for one, types in node.get_topic_names_and_types() if kind in types and one not in {topic, *own}]
    return [one for one in found if any(end.node != name and end.type == kind for end in publishers_of(node, one))]


def bases_elsewhere(node: Node, topic: str) -> list[str]:
    """Return other topics of commands to which a base subscribes."""
    names = [
        name for name, types in node.get_topic_names_and_types() if name != topic and TYPE_WORDS.keys() & set(types)
    ]
    return [name for name in names if bases(subscriptions_of(node, name))]


def full_name(endpoint: Any) -> str:
    """Return the full name of the node of a publisher or subscription.

    DDS reports the node name shortly after the endpoint, and never for non-ROS participants.
    """
    name = f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
    return "an unknown node" if "_UNKNOWN_" in name else name
