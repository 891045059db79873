"""Check a bag against its contract: one result per rule, with what was measured and the bound."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from diffbot_bag.tools.bag_info import BagInfo, TopicInfo
from diffbot_bag.tools.contract import Chosen, Contract
from diffbot_core.foreign_files import shown
from diffbot_core.schema import Spec, parameters_of
from diffbot_core.units import NS_PER_S

BAG = "bag"
"""Stands for a topic in the results of rules of the whole bag."""
_MAX_LISTED = 5
Value = float | int | str | bool | None


class Consistency(NamedTuple):
    """How consistent a filter's topic shows it to be; None where the topic does not tell."""

    nis_inside: float | None = None
    """share of the mean NIS that are within their 95 % chi-square bounds"""
    white: float | None = None
    """share of the autocorrelations of innovations within their 95 % bounds"""


class Result(NamedTuple):
    """One rule and what was measured."""

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
        wanted = f"must be {side}{_text(self.bound, self.unit)}"
        return f"{'PASS' if self.passed else 'FAIL'} {self.topic} {self.rule}: {measured}, {wanted}"


def _text(value: Value, unit: str) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g} {unit}".rstrip()
    return shown(value)


class _Measured(NamedTuple):
    """What the rules of a topic are compared with."""

    topic: TopicInfo
    info: BagInfo
    consistency: Consistency


def check_bag(contract: Contract, info: BagInfo, consistency: Mapping[str, Consistency]) -> list[Result]:
    """Compare a bag with its contract.

    Args:
        contract: the bounds.
        info: of the bag, with figures.
        consistency: of the topics that show one.
    """
    found = {topic.name: topic for topic in info.topics}
    results = list(_bag_results(contract, info))
    for name in contract.forbidden:
        count = found[name].message_count if name in found else 0
        results.append(Result(name, "forbidden", count == 0, f"{count} messages", "0 messages"))
    for name, chosen in contract.topics.items():
        topic = found.get(name)
        present = topic is not None and topic.message_count > 0
        needed = chosen.rules.required
        words = "in the bag" if present else "without a message" if topic else "not in the bag"
        results.append(
            Result(name, "required", present or not needed, words, "in the bag" if needed else "in the bag or not")
        )
        if topic is not None and present:
            results += _topic_results(chosen, _Measured(topic, info, consistency.get(name, Consistency())))
    return results


def _bag_results(contract: Contract, info: BagInfo) -> Iterator[Result]:
    chosen = contract.bag
    others = [topic.name for topic in info.topics if topic.name not in contract.topics and topic.message_count]
    forbidden = set(contract.forbidden)
    others = [name for name in others if name not in forbidden]
    for name in chosen.names:
        if name == "only_these_topics":
            more = f" and {len(others) - _MAX_LISTED} more" if len(others) > _MAX_LISTED else ""
            text = ", ".join(map(shown, others[:_MAX_LISTED])) + more
            if chosen.rules.only_these_topics:
                yield Result(BAG, name, not others, text or "no other topic", "no other topic")
            continue
        value = info.lost if name == "max_lost" else info.duration / NS_PER_S
        yield _compared(BAG, name, value, getattr(chosen.rules, name), _specs(chosen)[name])


def _specs(chosen: Chosen) -> dict[str, Spec]:
    return {parameter.name: parameter.spec for parameter in parameters_of(type(chosen.rules))}


def _topic_results(chosen: Chosen, measured: _Measured) -> Iterator[Result]:
    specs = _specs(chosen)
    for name in chosen.names:
        bound = getattr(chosen.rules, name)
        # `stamped: false` allows both.
        if name != "required" and bound is not False:
            value = _MEASURES[name](measured)
            yield _compared(measured.topic.name, name, value, bound, specs[name])


def _compared(topic: str, rule: str, value: Value, bound: Any, spec: Spec) -> Result:
    if value is None:
        passed = False
    elif rule.startswith("min_"):
        passed = value >= bound
    elif rule.startswith("max_"):
        passed = value <= bound
    else:
        passed = value == bound
    return Result(topic, rule, passed, value, bound, "" if spec.unit == "-" else spec.unit)


def _figure(name: str) -> Callable[[_Measured], Value]:
    return lambda one: getattr(one.topic.figures, name, None)


def _latency(name: str) -> Callable[[_Measured], Value]:
    return lambda one: getattr(one.topic.figures.latency if one.topic.figures else None, name, None)


def _no(name: str) -> Callable[[_Measured], Value]:
    def measure(one: _Measured) -> Value:
        count = getattr(one.topic.figures, name, None)
        return None if count is None else count == 0

    return measure


def _offered(policy: str) -> Callable[[_Measured], Value]:
    return lambda one: " and ".join(dict.fromkeys(getattr(qos, policy) for qos in one.topic.qos)) or None


def _start(one: _Measured) -> Value:
    return (one.topic.figures.first - one.info.start) / NS_PER_S if one.topic.figures else None


def _end(one: _Measured) -> Value:
    return (one.info.end - one.topic.figures.last) / NS_PER_S if one.topic.figures else None


_MEASURES: dict[str, Callable[[_Measured], Value]] = {
    "type": lambda one: one.topic.type,
    "min_count": lambda one: one.topic.message_count,
    "max_count": lambda one: one.topic.message_count,
    "min_rate": _figure("rate"),
    "max_rate": _figure("rate"),
    "max_gap": _figure("gap"),
    "max_stamp_gap": _figure("stamp_gap"),
    "max_start": _start,
    "max_end": _end,
    "max_lost": lambda one: one.topic.lost,
    "min_latency": _latency("smallest"),
    "max_latency_median": _latency("median"),
    "max_latency_p99": _latency("p99"),
    "stamped": _no("unstamped"),
    "monotone_stamps": _no("stamps_back"),
    "reliability": _offered("reliability"),
    "durability": _offered("durability"),
    "min_nis_inside": lambda one: one.consistency.nis_inside,
    "min_white": lambda one: one.consistency.white,
}
