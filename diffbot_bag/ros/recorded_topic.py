"""One topic that is being recorded, and those of its publishers that the subscription does not match."""

from __future__ import annotations

from typing import Any

from diffbot_bag.lost_messages import GapCounter
from diffbot_bag.qos import Qos
from diffbot_bag.ros_conversions import from_ros, offers
from diffbot_core.ros.publisher_watch import full_name


class RecordedTopic:
    """A topic, its channel in the bag, and what is known of its losses."""

    def __init__(self, name: str, type_name: str, channel: int, request: Qos) -> None:
        """Start with a topic and the QoS that is requested from its publishers."""
        self.name, self.type_name, self.channel, self.request = name, type_name, channel, request
        self.gaps = GapCounter()
        self.subscription: Any = None
        self.polls = 0
        self.unmatched: dict[str, str] = {}
        """why a publisher is not recorded, by the name of its node; empty if all are"""
        self.foreign_type = ""
        """the type of such a publisher, if it is another one than the topic's"""
        self.offers: tuple[Qos, ...] = ()
        """of the publishers of that type; of all, if there is none"""

    def update(self, node: Any) -> dict[str, str]:
        """Look at the publishers in the graph; return those newly found unmatched, with the reason."""
        matched = self.subscription.get_publisher_count()
        self.gaps.publishers = max(self.gaps.publishers, matched)
        self.polls += 1
        if node.count_publishers(self.name) <= matched:
            self.unmatched = {}
            return {}
        before, self.unmatched = self.unmatched, {}
        publishers = node.get_publishers_info_by_topic(self.name)
        for publisher in publishers:
            if reason := self._mismatch(publisher):
                self.unmatched[full_name(publisher)] = reason
                if publisher.topic_type != self.type_name:
                    self.foreign_type = self.foreign_type or publisher.topic_type
        counted = self.foreign_type or self.type_name
        self.offers = offers([publisher for publisher in publishers if publisher.topic_type == counted])
        return {name: reason for name, reason in self.unmatched.items() if before.get(name) != reason}

    def _mismatch(self, publisher: Any) -> str:
        """Return why the subscription does not match a publisher; empty if it does, be it a moment later."""
        if publisher.topic_type != self.type_name:
            return f"its type is {publisher.topic_type}"
        offered = from_ros(publisher.qos_profile)
        if self.request.reliability == "reliable" and offered.reliability == "best_effort":
            return "it offers best effort only"
        if self.request.durability == "transient_local" and offered.durability == "volatile":
            return "it is not transient local"
        return ""
