"""Measure the consistency of a filter in a bag by the share of mean NIS values within their 95 % bounds."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from diffbot_bag.bag import BagReader
from diffbot_control.filter.consistency import nis_bounds
from diffbot_tools.filter_statistics import NIS_LABELS, NIS_TOPIC

STATUS, LABELLED = "diagnostic_msgs/msg/DiagnosticStatus", "std_msgs/msg/Float64MultiArray"
_MAX_NUMBERS = 3
"""largest dimension of a measurement"""
_WINDOW = 50
"""number of measurements in a mean"""


def nis_shares(reader: BagReader, names: Iterable[str]) -> dict[str, float | None]:
    """Return the share for each of the topics whose type can contain a NIS; None for a topic without NIS.

    Raises:
        DiffbotError: if a message cannot be decoded, or a file is damaged.
    """
    shares: dict[str, float | None] = {}
    for name, topic in ((name, reader.topics[name]) for name in names if name in reader.topics):
        if topic.type == STATUS:
            shares[name] = share_of_statuses(message.content for message in reader.decoded([name]))
        elif topic.type == LABELLED and name.endswith(NIS_TOPIC):
            shares[name] = share_of_windows(message.content for message in reader.decoded([name]))
    return shares


def share_of_statuses(messages: Iterable[Any]) -> float | None:
    """Return the share for messages of ``ekf/status``, each of which has a mean NIS and its bounds."""
    inside = []
    for message in messages:
        values = {pair.key: pair.value for pair in message.values}
        words = [values.get("NIS per number", ""), *values.get("NIS 95 % bounds", "").split(" ")]
        try:
            nis, low, high = (float(word.split()[0]) for word in words)
        except (ValueError, IndexError):
            continue
        if not math.isnan(nis) and low <= high:
            inside.append(low <= nis <= high)
    return _share(inside)


def share_of_windows(messages: Iterable[Any]) -> float | None:
    """Return the share for messages of ``ekf/nis`` in a refiltered bag, averaged over windows of measurements."""
    used = []
    for message in messages:
        labels = tuple(dimension.label for dimension in message.layout.dim)
        if labels != NIS_LABELS or len(message.data) != len(NIS_LABELS):
            continue
        nis, numbers, accepted = message.data
        if accepted and 1 <= numbers <= _MAX_NUMBERS:
            used.append((nis, int(numbers)))
    inside = []
    # Windows that do not overlap.
    for first in range(0, len(used) - _WINDOW + 1, _WINDOW):
        window = used[first : first + _WINDOW]
        count = sum(numbers for _, numbers in window)
        low, high, _ = nis_bounds(count)
        inside.append(low <= sum(nis for nis, _ in window) / count <= high)
    return _share(inside)


def _share(inside: list[bool]) -> float | None:
    return sum(inside) / len(inside) if inside else None
