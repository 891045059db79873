"""Draft of a contract from a bag that is known to be good, with margins."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import yaml

from diffbot_bag.tools.bag_info import BagInfo, TopicInfo
from diffbot_bag.tools.contract import VERSION
from diffbot_bag.tools.contract_check import Consistency
from diffbot_core.units import NS_PER_S

MIN_PERIODIC = 20
"""Messages below which a topic gets no rate."""
MAX_IRREGULARITY = 5.0
"""Longest gap of a periodic topic in mean intervals."""
RATE_MARGIN = 1.25
GAP_MARGIN = 2.0
LATENCY_MARGIN = 2.0
SMALLEST_LATENCY = 0.01
"""[s] added to the bounds of the latency: clocks differ, and a machine is busy at times"""
SHARE_MARGIN = 0.2
_WORDS = ("reliable", "best_effort", "volatile", "transient_local")
_HEAD = """\
# Drafted from {path}: read it, and widen or delete what is no requirement.
# Check a bag with: diffbot bag check BAG THIS_FILE
"""


def draft_contract(info: BagInfo, consistency: Mapping[str, Consistency]) -> str:
    """Return the YAML text of a contract that the bag keeps.

    Args:
        info: of the bag, with figures.
        consistency: of the topics that show one.
    """
    bag: dict[str, Any] = {} if info.lost is None else {"max_lost": info.lost}
    topics = {
        topic.name: _topic_rules(topic, info, consistency.get(topic.name, Consistency()))
        for topic in info.topics
        if topic.message_count
    }
    content = {"version": VERSION, "bag": bag, "topics": topics, "forbidden": []}
    return _HEAD.format(path=info.path.name) + "\n" + yaml.safe_dump(content, sort_keys=False)


def _topic_rules(topic: TopicInfo, info: BagInfo, consistency: Consistency) -> dict[str, Any]:
    rules: dict[str, Any] = {"type": topic.type, "min_count": 1} | _timing(topic, info)
    if topic.lost is not None:
        rules["max_lost"] = topic.lost
    rules |= _stamps(topic)
    for policy in ("reliability", "durability"):
        offered = {getattr(qos, policy) for qos in topic.qos}
        # Others, such as unknown, are no rule.
        if len(offered) == 1 and (word := offered.pop()) in _WORDS:
            rules[policy] = word
    shares = (("min_nis_inside", consistency.nis_inside), ("min_white", consistency.white))
    return rules | {name: round_down(max(share - SHARE_MARGIN, 0.0)) for name, share in shares if share is not None}


def _timing(topic: TopicInfo, info: BagInfo) -> dict[str, Any]:
    figures = topic.figures
    if figures is None or figures.rate is None or figures.gap is None or figures.message_count < MIN_PERIODIC:
        return {}
    if figures.gap * figures.rate > MAX_IRREGULARITY:
        return {}
    gap = round_up(max(GAP_MARGIN * figures.gap, 3.0 / figures.rate))
    start, end = (figures.first - info.start) / NS_PER_S, (info.end - figures.last) / NS_PER_S
    return {
        "min_rate": round_down(figures.rate / RATE_MARGIN),
        "max_rate": round_up(figures.rate * RATE_MARGIN),
        "max_gap": gap,
        "max_start": round_up(start + gap),
        "max_end": round_up(end + gap),
    }


def _stamps(topic: TopicInfo) -> dict[str, Any]:
    figures = topic.figures
    if figures is None or figures.latency is None:
        return {}
    smallest, _, p99 = figures.latency
    rules: dict[str, Any] = {
        "min_latency": round_down(min(smallest, 0.0) * LATENCY_MARGIN - SMALLEST_LATENCY),
        "max_latency_p99": round_up(max(p99, 0.0) * LATENCY_MARGIN + SMALLEST_LATENCY),
    }
    if figures.stamp_gap and figures.rate and figures.stamp_gap * figures.rate <= MAX_IRREGULARITY:
        rules["max_stamp_gap"] = round_up(GAP_MARGIN * figures.stamp_gap)
    if figures.unstamped == 0:
        rules["stamped"] = True
    if figures.stamps_back == 0:
        rules["monotone_stamps"] = True
    return rules


def round_up(value: float) -> float:
    """Round to two significant digits, never below the value."""
    return -round_down(-value)


def round_down(value: float) -> float:
    """Round to two significant digits, never above the value."""
    if value == 0.0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(abs(value))) - 1)
    return float(f"{math.floor(value / step) * step:.6g}")
