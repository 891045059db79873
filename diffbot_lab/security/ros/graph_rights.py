"""The rights that a running node uses, as the graph shows them."""

from __future__ import annotations

import re

from rclpy.node import Node

from diffbot_lab.security.policy import Rights, name_in_policy

_OF_ACTION = re.compile(r"(.+)/_action/\w+")
"""Topics and services that an action consists of."""


def rights_of(observer: Node, node: str, namespace: str) -> Rights:
    """Return what a node has in the graph, as far as ``observer`` has discovered it.

    Raises:
        rclpy.node.NodeNameNonExistentError: if no such node is discovered.
    """
    look = {
        "publish": observer.get_publisher_names_and_types_by_node,
        "subscribe": observer.get_subscriber_names_and_types_by_node,
        "reply": observer.get_service_names_and_types_by_node,
        "request": observer.get_client_names_and_types_by_node,
    }
    names = {
        right: {name_in_policy(name, node, namespace) for name, _ in list_names(node, namespace)}
        for right, list_names in look.items()
    }
    execute, call = _actions(names["reply"]), _actions(names["request"])
    for found in names.values():
        found.difference_update([name for name in found if _OF_ACTION.fullmatch(name)])
    return Rights(**{right: frozenset(found) for right, found in names.items()}, execute=execute, call=call)


def _actions(services: set[str]) -> frozenset[str]:
    """Return the actions that services belong to."""
    return frozenset(match.group(1) for name in services if (match := _OF_ACTION.fullmatch(name)))
