"""Watch over topics that one node has to own: a second publisher of them is reported with the names of all."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

LEASE = 20.0
"""[s] for which DDS (Fast DDS by default) counts the publishers of a process that was killed"""


class _Owned(NamedTuple):
    role: str
    limit: int


def publisher_names(node: Node, topic: str) -> list[str]:
    """Return the full names of the nodes that publish a topic, sorted, one for each publisher; no remapping is done."""
    return sorted(map(full_name, node.get_publishers_info_by_topic(topic)))


def full_name(endpoint: Any) -> str:
    """Return the full name of the node of a publisher or subscription.

    DDS tells it a moment after the endpoint, and never of a program that is no ROS node.
    """
    name = f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
    return "an unknown node" if "_UNKNOWN_" in name else name


def too_many(topic: str, names: list[str], limit: int, role: str) -> str:
    """Return in words that a topic has more publishers than ``limit``; empty if it has not.

    Args:
        topic: its full name.
        names: of the nodes that publish it, one for each publisher.
        limit: how many may publish it.
        role: what only they may do, as in "only one may own time".
    """
    if len(names) <= limit:
        return ""
    allowed = "one" if limit == 1 else str(limit)
    return f"{len(names)} publishers of {topic}, only {allowed} may {role}: {', '.join(names)}"


class PublisherWatch:
    """What is wrong with the publishers of the topics that a node uses.

    With two controllers on one cmd_vel the robot obeys each in turn, and with two sources of the pose it is steered by
    two estimates. Nothing else shows it: every message is valid. Publishers are counted whether they send or not.
    """

    def __init__(self, node: Node) -> None:
        """Watch nothing yet; the topics are those that ``node`` resolves."""
        self._node = node
        self.problem = ""
        """the topics with too many publishers, in words; empty if there is none"""
        self._owned: dict[str, _Owned] = {}
        self._reported: dict[str, str] = {}
        self._since: dict[str, float] = {}
        self.level = int(DiagnosticStatus.OK[0])
        """of the problem in /diagnostics: WARN while the surplus publishers may be those of a killed process"""

    def watch(self, topic: str, role: str, limit: int = 1) -> None:
        """Watch one more topic, or the same one with another limit.

        Args:
            topic: as the node names it; remapped as its publishers and subscriptions are.
            role: what only the allowed publishers may do, see :func:`too_many`.
            limit: how many publishers are allowed, the node's own included.
        """
        self._owned[self._node.resolve_topic_name(topic)] = _Owned(role, limit)

    def check(self, active: bool = True) -> None:
        """Count publishers and log each change; called once a second.

        Args:
            active: False for a node that leaves its topics to others; it has no problem with them.
        """
        found, level, now = {}, DiagnosticStatus.OK, time.monotonic()
        for topic, (role, limit) in self._owned.items() if active else ():
            names = publisher_names(self._node, topic)
            if not (text := too_many(topic, names, limit, role)):
                continue
            since = self._since.setdefault(topic, now)
            if len(set(names)) <= limit and now - since <= 1.5 * LEASE:
                text += f" (one that was killed still counts for {LEASE:g} s)"
                level = max(level, DiagnosticStatus.WARN)
            else:
                level = DiagnosticStatus.ERROR
            found[topic] = text
        self._log(found)
        self._since = {topic: since for topic, since in self._since.items() if topic in found}
        self.problem, self.level = "; ".join(found.values()), int(level[0])

    def _log(self, found: dict[str, str]) -> None:
        logger = self._node.get_logger()
        for topic, text in found.items():
            if text != self._reported.get(topic):
                logger.error(text)
        for topic in self._reported.keys() - found.keys():
            logger.info(f"{topic}: no more publishers than allowed")
        self._reported = found
