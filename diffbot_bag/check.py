"""Check a bag against a contract: required topics, and bounds of rates, gaps, losses and latencies."""

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
"""version of the format of contracts"""
MAX_BYTES = 2**20
"""[bytes] largest contract that is read"""
BAG = "bag"
"""Section of the rules for the whole bag; in results, it stands in place of a topic."""
_MAX_COUNT = 2**63 - 1
_SPAN = "time from the first to the last message"
_RATE = "number of intervals divided by the time from the first to the last message"
_MAX_BOUND = 1e9
"""[s or Hz] largest finite bound"""
Value = float | int | str | bool | None


class BagRules(NamedTuple):
    """Rules for the whole bag."""

    min_duration: Annotated[float, Spec(_SPAN, "s", 0.0, _MAX_BOUND)] = 0.0
    max_duration: Annotated[float, Spec(_SPAN, "s", 0.0, _MAX_BOUND, allow_inf=True)] = math.inf
    max_lost: Annotated[int, Spec("number of lost messages of all topics", minimum=0, maximum=_MAX_COUNT)] = _MAX_COUNT
    only_these_topics: Annotated[bool, Spec("true: all messages are of topics that are listed under `topics`")] = False


class TopicRules(NamedTuple):
    """Rules for one topic."""

    required: Annotated[bool, Spec("false: check the other rules only if the bag has messages of the topic")] = True
    type: Annotated[str, Spec("message type, such as nav_msgs/msg/Odometry")] = ""
    min_count: Annotated[int, Spec("number of messages", minimum=0, maximum=_MAX_COUNT)] = 0
    max_count: Annotated[int, Spec("number of messages", minimum=0, maximum=_MAX_COUNT)] = _MAX_COUNT
    min_rate: Annotated[float, Spec(_RATE, "Hz", 0.0, _MAX_BOUND)] = 0.0
    max_rate: Annotated[float, Spec(_RATE, "Hz", 0.0, _MAX_BOUND, allow_inf=True)] = math.inf
    max_gap: Annotated[float, Spec("time between two consecutive messages", "s", 0.0, _MAX_BOUND, allow_inf=True)] = (
        math.inf
    )
    max_stamp_gap: Annotated[
        float,
        Spec(
            "step between two consecutive stamps; it does not depend on delays of the recorder",
            "s",
            0.0,
            _MAX_BOUND,
            allow_inf=True,
        ),
    ] = math.inf
    max_lost: Annotated[int, Spec("number of lost messages, see `diffbot bag info`", minimum=0, maximum=_MAX_COUNT)] = (
        _MAX_COUNT
    )
    min_latency: Annotated[
        float, Spec("smallest log time minus stamp; negative if a stamp is in the future", "s", -_MAX_BOUND, _MAX_BOUND)
    ] = 0.0
    max_latency_p99: Annotated[
        float, Spec("99 % quantile of log time minus stamp", "s", -_MAX_BOUND, _MAX_BOUND, allow_inf=True)
    ] = math.inf
    stamped: Annotated[bool, Spec("true: every message has a stamp other than 0")] = False
    monotone_stamps: Annotated[bool, Spec("true: no stamp is earlier than the previous stamp")] = False
    reliability: Annotated[
        str, Spec("reliability that every publisher offers", choices=("reliable", "best_effort"))
    ] = "reliable"
    durability: Annotated[
        str, Spec("durability that every publisher offers", choices=("volatile", "transient_local"))
    ] = "volatile"
    min_nis_inside: Annotated[
        float, Spec("share of the mean NIS values within their 95 % bounds", minimum=0.0, maximum=1.0)
    ] = 0.0


class BagContract(NamedTuple):
    """A contract: the bound of each rule that is checked, by the name of the rule."""

    bag: Mapping[str, Any]
    """bounds of BagRules"""
    topics: Mapping[str, Mapping[str, Any]]
    """bounds of TopicRules by topic, in the order of the file"""


class RuleResult(NamedTuple):
    """Result of one rule."""

    topic: str
    """name of the topic, or BAG"""
    rule: str
    passed: bool
    measured: Value
    """measured value; None if it could not be measured, in which case the rule fails"""
    bound: Value
    unit: str = ""

    def line(self) -> str:
        """Return the result as one line."""
        measured = "not measured" if self.measured is None else _text(self.measured, self.unit)
        comparison = {"min_": ">= ", "max_": "<= "}.get(self.rule[:4], "")
        bound = f"must be {comparison}{_text(self.bound, self.unit)}"
        return f"{'PASS' if self.passed else 'FAIL'} {shown(self.topic)} {self.rule}: {measured}, {bound}"


def _text(value: Value, unit: str) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g} {unit}".rstrip() if isinstance(value, float) else shown(value)


def read_contract(path: Path) -> BagContract:
    """Read a contract.

    Raises:
        DiffbotError: if the file cannot be read, a key is unknown or a value is not allowed.
    """
    name = shown(path)
    sections = _map(load_yaml(read_text(path, MAX_BYTES), name, unique_keys=True), f"{name}: the contract")
    known = ("version", BAG, "topics")
    if unknown := [key for key in sections if key not in known]:
        raise DiffbotError(f"{name}: {shown(repr(unknown[0]))} is not a section: must be one of {', '.join(known)}")
    if (version := sections.get("version")) != VERSION:
        raise DiffbotError(f"{name}: version = {shown(repr(version))}: must be {VERSION}")
    topics = {}
    for topic, rules in _map(sections.get("topics"), f"{name}: topics").items():
        if not isinstance(topic, str) or not topic.startswith("/"):
            raise DiffbotError(f"{name}: topics: {shown(repr(topic))} must be the full name of a topic, such as /odom")
        topics[topic] = _bounds(TopicRules, rules, f"{name}: {shown(topic)}")
    return BagContract(_bounds(BagRules, sections.get(BAG), f"{name}: bag"), topics)


def _map(content: Any, place: str) -> dict[Any, Any]:
    if not isinstance(content, dict | None):
        raise DiffbotError(f"{place} = {shown(repr(content))}: must be a map")
    return content or {}


def _bounds(kind: type[BagRules] | type[TopicRules], content: Any, place: str) -> dict[str, Any]:
    """Return the bounds that a section of a contract gives, in the order of the fields of ``kind``."""
    values = _map(content, place)
    try:
        rules = build(kind, values)
        for low, high in ((name, name.replace("min_", "max_")) for name in kind._fields if name.startswith("min_")):
            if getattr(rules, low) > getattr(rules, high, math.inf):
                raise InvalidValueError(low, getattr(rules, low), f"<= {high} = {getattr(rules, high)!r}")
    except InvalidValueError as error:
        raise DiffbotError(f"{place}: {error}") from error
    return {name: getattr(rules, name) for name in kind._fields if name in values}


def check_bag(contract: BagContract, info: BagInfo, nis_inside: Mapping[str, float | None]) -> list[RuleResult]:
    """Compare a bag with a contract.

    Args:
        contract: the contract.
        info: description of the bag, with figures of topics.
        nis_inside: share of the mean NIS values within their 95 % bounds, by topic.
    """
    measures: dict[str, Value] = {"duration": info.duration / NS_PER_S, "lost": info.lost}
    results = list(_results(BAG, contract.bag, BagRules, measures))
    if contract.bag.get("only_these_topics"):
        others = [
            shown(topic.name) for topic in info.topics if topic.message_count and topic.name not in contract.topics
        ]
        found = ", ".join(others[:5]) + (f" and {len(others) - 5} more" if len(others) > 5 else "")
        results.append(RuleResult(BAG, "only_these_topics", not others, found or "no other topic", "no other topic"))
    topics = {topic.name: topic for topic in info.topics}
    for name, bounds in contract.topics.items():
        topic = topics.get(name)
        is_present = topic is not None and topic.message_count > 0
        measured = "in the bag" if is_present else "without messages" if topic else "not in the bag"
        is_required = bounds.get("required", True)
        bound = "in the bag" if is_required else "in the bag or not"
        results.append(RuleResult(name, "required", is_present or not is_required, measured, bound))
        if topic is not None and is_present:
            results += _results(name, bounds, TopicRules, _measures(topic) | {"nis_inside": nis_inside.get(name)})
    return results


def _measures(topic: TopicInfo) -> dict[str, Value]:
    """Return the measured values by the name of the rule without ``min_`` or ``max_``."""
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
    units = {parameter.name: parameter.spec.unit for parameter in parameters_of(kind)}
    for rule, bound in bounds.items():
        # The bound `false` allows both values.
        if rule in ("required", "only_these_topics") or bound is False:
            continue
        value: Any = measures.get(rule.removeprefix("min_").removeprefix("max_"))
        holds = {"min_": operator.ge, "max_": operator.le}.get(rule[:4], operator.eq)
        passed = value is not None and bool(holds(value, bound))
        yield RuleResult(topic, rule, passed, value, bound, units[rule].replace("-", ""))
