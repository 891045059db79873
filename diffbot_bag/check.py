"""Check a bag against its contract: which topics it has to have, and the bounds of their rates, gaps and losses."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from diffbot_bag.info import BagInfo, TopicInfo
from diffbot_core.errors import DiffbotError, InvalidValueError, shown
from diffbot_core.files import read_text
from diffbot_core.schema import Spec, build, parameters_of
from diffbot_core.stamps import NS_PER_S
from diffbot_core.yaml_files import load_yaml

VERSION = 1
"""of the format"""
MAX_BYTES = 2**20
"""of a contract"""
BAG = "bag"
"""Stands for a topic in the results of rules of the whole bag."""
_MAX_COUNT = 2**63 - 1
_SPAN = "time from the first to the last message"
_RATE = "intervals over the time from first to last message"
_MOST = 1e9
"""[s, Hz] no bag has more"""
Value = float | int | str | bool | None


class BagRules(NamedTuple):
    """Rules of the whole bag."""

    min_duration: Annotated[float, Spec(_SPAN, "s", 0.0, _MOST)] = 0.0
    max_duration: Annotated[float, Spec(_SPAN, "s", 0.0, _MOST, allow_inf=True)] = math.inf
    max_lost: Annotated[int, Spec("lost messages of all topics", minimum=0, maximum=_MAX_COUNT)] = _MAX_COUNT
    only_these_topics: Annotated[bool, Spec("no topic but those under `topics`")] = False


class TopicRules(NamedTuple):
    """Rules of one topic."""

    required: Annotated[bool, Spec("false: the other rules hold only if the bag has a message of the topic")] = True
    type: Annotated[str, Spec("pkg/msg/Type")] = ""
    min_count: Annotated[int, Spec("messages", minimum=0, maximum=_MAX_COUNT)] = 0
    max_count: Annotated[int, Spec("messages", minimum=0, maximum=_MAX_COUNT)] = _MAX_COUNT
    min_rate: Annotated[float, Spec(_RATE, "Hz", 0.0, _MOST)] = 0.0
    max_rate: Annotated[float, Spec(_RATE, "Hz", 0.0, _MOST, allow_inf=True)] = math.inf
    max_gap: Annotated[float, Spec("time between neighbouring messages", "s", 0.0, _MOST, allow_inf=True)] = math.inf
    max_stamp_gap: Annotated[
        float,
        Spec("step from one stamp to the next, however late they were recorded", "s", 0.0, _MOST, allow_inf=True),
    ] = math.inf
    max_lost: Annotated[int, Spec("lost messages, as `lost` of `diffbot bag info`", minimum=0, maximum=_MAX_COUNT)] = (
        _MAX_COUNT
    )
    min_latency: Annotated[
        float, Spec("smallest log time minus stamp; negative: a stamp in the future", "s", -_MOST, _MOST)
    ] = 0.0
    max_latency_p99: Annotated[
        float, Spec("99 % quantile of log time minus stamp", "s", -_MOST, _MOST, allow_inf=True)
    ] = math.inf
    stamped: Annotated[bool, Spec("true: every message has a stamp other than 0")] = False
    monotone_stamps: Annotated[bool, Spec("true: no stamp is earlier than that of the previous message")] = False
    reliability: Annotated[str, Spec("offered by every publisher", choices=("reliable", "best_effort"))] = "reliable"
    durability: Annotated[str, Spec("offered by every publisher", choices=("volatile", "transient_local"))] = "volatile"
    min_nis_inside: Annotated[
        float, Spec("share of the mean NIS within their 95 % bounds", minimum=0.0, maximum=1.0)
    ] = 0.0


class Contract(NamedTuple):
    """The rules that a contract names, and their bounds: only these are checked."""

    bag: Mapping[str, Any]
    """of BagRules"""
    topics: Mapping[str, Mapping[str, Any]]
    """of TopicRules, by topic in the order of the file"""


class RuleResult(NamedTuple):
    """One rule and the measured value."""

    topic: str
    """or BAG"""
    rule: str
    passed: bool
    measured: Value
    """None if the bag does not tell; the rule fails then"""
    bound: Value
    unit: str = ""

    def line(self) -> str:
        """Return the result as one line."""
        measured = "not measured" if self.measured is None else _text(self.measured, self.unit)
        side = {"min_": ">= ", "max_": "<= "}.get(self.rule[:4], "")
        bound = f"must be {side}{_text(self.bound, self.unit)}"
        return f"{'PASS' if self.passed else 'FAIL'} {shown(self.topic)} {self.rule}: {measured}, {bound}"


def _text(value: Value, unit: str) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g} {unit}".rstrip() if isinstance(value, float) else shown(value)


def read_contract(path: Path) -> Contract:
    """Read a contract.

    Raises:
        DiffbotError: in one line: a file that cannot be read, an unknown key, a value that is not allowed.
    """
    name = shown(path)
    sections = _map(load_yaml(read_text(path, MAX_BYTES), name, unique_keys=True), f"{name}: the contract")
    known = ("version", BAG, "topics")
    if unknown := [key for key in sections if key not in known]:
        raise DiffbotError(f"{name}: {shown(repr(unknown[0]))} is unknown: must be one of {', '.join(known)}")
    if (version := sections.get("version")) != VERSION:
        raise DiffbotError(f"{name}: version = {shown(repr(version))}: must be {VERSION}")
    topics = {}
    for topic, rules in _map(sections.get("topics"), f"{name}: topics").items():
        if not isinstance(topic, str) or not topic.startswith("/"):
            raise DiffbotError(f"{name}: topics: {shown(repr(topic))}: must be the full name of a topic, such as /odom")
        topics[topic] = _bounds(TopicRules, rules, f"{name}: {shown(topic)}")
    return Contract(_bounds(BagRules, sections.get(BAG), f"{name}: bag"), topics)


def _map(content: Any, place: str) -> dict[Any, Any]:
    if not isinstance(content, dict | None):
        raise DiffbotError(f"{place} = {shown(repr(content))}: must be a map")
    return content or {}


def _bounds(kind: type[BagRules] | type[TopicRules], content: Any, place: str) -> dict[str, Any]:
    """Return the bounds that a section of a contract names, in the order of the rules' definition."""
    values = _map(content, place)
    try:
        rules = build(kind, values)
        for low, high in ((name, name.replace("min_", "max_")) for name in kind._fields if name.startswith("min_")):
            if getattr(rules, low) > getattr(rules, high, math.inf):
                raise InvalidValueError(low, getattr(rules, low), f"<= {high} = {getattr(rules, high)!r}")
    except InvalidValueError as error:
        raise DiffbotError(f"{place}: {error}") from error
    return {name: getattr(rules, name) for name in kind._fields if name in values}


def check_bag(contract: Contract, info: BagInfo, nis_inside: Mapping[str, float | None]) -> list[RuleResult]:
    """Compare a bag with its contract.

    Args:
        contract: the bounds.
        info: description of the bag, with figures.
        nis_inside: share of the mean NIS within their 95 % bounds, for topics that contain a NIS.
    """
    measures: dict[str, Value] = {"duration": info.duration / NS_PER_S, "lost": info.lost}
    results = list(_results(BAG, contract.bag, BagRules, measures))
    if contract.bag.get("only_these_topics"):
        others = [shown(one.name) for one in info.topics if one.message_count and one.name not in contract.topics]
        found = ", ".join(others[:5]) + (f" and {len(others) - 5} more" if len(others) > 5 else "")
        results.append(RuleResult(BAG, "only_these_topics", not others, found or "no other topic", "no other topic"))
    topics = {topic.name: topic for topic in info.topics}
    for name, bounds in contract.topics.items():
        topic = topics.get(name)
        is_present = topic is not None and topic.message_count > 0
        words = "in the bag" if is_present else "without a message" if topic else "not in the bag"
        is_required = bounds.get("required", True)
        bound = "in the bag" if is_required else "in the bag or not"
        results.append(RuleResult(name, "required", is_present or not is_required, words, bound))
        if topic is not None and is_present:
            results += _results(name, bounds, TopicRules, _measures(topic) | {"nis_inside": nis_inside.get(name)})
    return results


def _measures(topic: TopicInfo) -> dict[str, Value]:
    """Return the value that each rule bounds, without its ``min_`` or ``max_``; None where the bag does not tell."""
    measures: dict[str, Value] = {"type": topic.type, "count": topic.message_count, "lost": topic.lost}
    if figures := topic.figures:
        measures |= {"rate": figures.rate, "gap": figures.gap, "stamp_gap": figures.stamp_gap}
        if figures.latency:
            measures |= {"latency": figures.latency.smallest, "latency_p99": figures.latency.p99}
        if figures.unstamped is not None and figures.stamps_back is not None:
            measures |= {"stamped": figures.unstamped == 0, "monotone_stamps": figures.stamps_back == 0}
    for policy in ("reliability", "durability"):
        measures[policy] = " and ".join(dict.fromkeys(getattr(qos, policy) for qos in topic.qos)) or None
    return measures


def _results(
    topic: str,
    bounds: Mapping[str, Any],
    kind: type[BagRules] | type[TopicRules],
    measures: Mapping[str, Value],
) -> Iterator[RuleResult]:
    units = {one.name: one.spec.unit for one in parameters_of(kind)}
    for rule, bound in bounds.items():
        # `stamped: false` allows both.
        if rule in ("required", "only_these_topics") or bound is False:
            continue
        value: Any = measures.get(rule.removeprefix("min_").removeprefix("max_"))
        holds = {"min_": operator.ge, "max_": operator.le}.get(rule[:4], operator.eq)
        passed = value is not None and bool(holds(value, bound))
        yield RuleResult(topic, rule, passed, value, bound, units[rule].replace("-", ""))
