"""One topic that is being recorded: its subscription, and the publishers that this does not match."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from diffbot_bag.bag.qos import Qos, to_request
from diffbot_bag.record.lost_messages import GapCounter
from diffbot_bag.ros.conversions import from_ros, offers, take_pending, to_ros, with_info
from diffbot_core.ros.publisher_watch import full_name

Receive = Callable[[bytes, dict[str, Any]], None]
_OVERLAP_POLLS = 5
"""Polls for which the old and the new subscription exist together, at least."""
_MAX_OVERLAP_POLLS = 50


class _Replacement:
    """A weaker subscription, whose messages wait until it has all publishers of the old one."""

    def __init__(self, request: Qos) -> None:
        self.request = request
        self.subscription: Any = None
        self.waiting: list[tuple[bytes, dict[str, Any]]] = []
        self.polls = 0


class RecordedTopic:
    """A topic, its channel in the bag, and what is known of its losses."""

    def __init__(self, name: str, type_name: str, channel: int, request: Qos, fixed: bool = False) -> None:
        """Start with a topic and the QoS that is requested from its publishers; ``fixed``: whatever they offer."""
        self.name, self.type_name, self.channel, self.request, self.fixed = name, type_name, channel, request, fixed
        self.gaps = GapCounter()
        self.received = 0
        """messages accepted"""
        self.subscription: Any = None
        self.polls = 0
        self.unmatched: dict[str, str] = {}
        """why a publisher is not recorded, by the name of its node; empty if all are"""
        self._receive: Receive = _nothing
        self._class: Any = None
        self._replacement: _Replacement | None = None
        self.seen: set[tuple[int, int | None]] | None = None
        """source timestamp and number of messages received while there are two subscriptions"""
        self._forget = 0

    def subscribe(self, node: Any, message_class: Any, receive: Receive) -> None:
        """Subscribe; ``receive`` gets the bytes and the info of each message once."""
        self._class, self._receive = message_class, receive
        self.subscription = self._make(node, self.request, self._receive)

    def _make(self, node: Any, request: Qos, callback: Receive) -> Any:
        return node.create_subscription(self._class, self.name, with_info(callback), to_ros(request), raw=True)

    def is_first(self, published: int, number: int | None) -> bool:
        """Return whether neither subscription, old or new, received this message before; to be called if ``seen``."""
        if self.seen is None or (key := (published, number)) in self.seen:
            return self.seen is None
        self.seen.add(key)
        return True

    def take_pending(self) -> int | None:
        """Receive a message that waits for the executor; return its source timestamp [ns], None if there was none."""
        if (taken := take_pending(self.subscription)) is None:
            return None
        self._receive(*taken)
        return int(taken[1]["source_timestamp"])

    def update(self, node: Any) -> dict[str, str]:
        """Look at the publishers in the graph; return those newly found unmatched, with the reason."""
        self._continue_replacement(node)
        matched = self.subscription.get_publisher_count()
        self.gaps.publishers = max(self.gaps.publishers, matched)
        self.polls += 1
        if node.count_publishers(self.name) <= matched:
            self.unmatched = {}
            return {}
        before, self.unmatched = self.unmatched, {}
        for publisher in node.get_publishers_info_by_topic(self.name):
            if reason := self._mismatch(publisher):
                self.unmatched[full_name(publisher)] = reason
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

    def weaken(self, node: Any) -> bool:
        """Begin to subscribe anew so that all publishers of the topic's type match; return whether that helps."""
        if self.fixed:
            return False
        publishers = node.get_publishers_info_by_topic(self.name)
        same = offers([publisher for publisher in publishers if publisher.topic_type == self.type_name])
        request = to_request((*same, self.request), self.request.depth)
        if request == self.request:
            return False
        if self._replacement is None:
            self._replacement = made = _Replacement(request)
            self.seen = set()
            made.subscription = self._make(node, request, lambda data, info: self._wait(made, data, info))
        return True

    def _wait(self, replacement: _Replacement, data: bytes, info: dict[str, Any]) -> None:
        if self._replacement is replacement:
            replacement.waiting.append((data, info))
        else:
            self._receive(data, info)

    def _continue_replacement(self, node: Any) -> None:
        """Change over once the new subscription has all publishers; forget duplicates a while later."""
        if (made := self._replacement) is None:
            self._forget -= 1
            if self._forget == 0:
                self.seen = None
            return
        made.polls += 1
        complete = made.subscription.get_publisher_count() >= node.count_publishers(self.name)
        if not (complete and made.polls >= _OVERLAP_POLLS) and made.polls < _MAX_OVERLAP_POLLS:
            return
        # The old one's first: it has the messages in the order of their publisher, from before and during the overlap.
        while self.take_pending() is not None:
            pass
        old, self.subscription, self.request = self.subscription, made.subscription, made.request
        self._replacement, self._forget = None, _MAX_OVERLAP_POLLS
        self.gaps.publishers = max(self.gaps.publishers, made.subscription.get_publisher_count())
        for data, info in made.waiting:
            self._receive(data, info)
        node.destroy_subscription(old)

    def finish(self, node: Any) -> None:
        """Before the end: change over at once, if a new subscription was made."""
        if self._replacement is not None:
            self._replacement.polls = _MAX_OVERLAP_POLLS
            self._continue_replacement(node)


def _nothing(_data: bytes, _info: dict[str, Any]) -> None:
    """Before the topic is subscribed to."""
