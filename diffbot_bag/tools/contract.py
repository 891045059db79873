"""Contract of a bag: which topics it has to have and within which bounds, read from YAML and checked."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

from diffbot_core.bounded_yaml import load_yaml
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.foreign_files import read_text, shown
from diffbot_core.schema import Spec, build

VERSION = 1
"""of the format"""
MAX_BYTES = 2**20
MAX_TOPICS = 10_000
"""as many as the figures of a bag are computed for"""
MAX_TEXT = 256
"""characters of one key or value"""
_MAX_COUNT = 2**63 - 1
_LONG = 1e10
"""[s] three hundred years; [Hz] more than the nanoseconds of log times can tell apart"""
_TOPIC = re.compile(r"/[A-Za-z0-9_/~{}-]+")
_SECTIONS = ("version", "bag", "topics", "forbidden")
R = TypeVar("R", bound=tuple[Any, ...])


class BagRules(NamedTuple):
    """Rules of the whole bag."""

    min_duration: Annotated[float, Spec("time from the first to the last message", "s", minimum=0.0, maximum=_LONG)] = (
        0.0
    )
    max_duration: Annotated[
        float, Spec("time from the first to the last message", "s", minimum=0.0, maximum=_LONG, allow_inf=True)
    ] = math.inf
    max_lost: Annotated[int, Spec("lost messages of all topics", minimum=0, maximum=_MAX_COUNT)] = _MAX_COUNT
    only_these_topics: Annotated[bool, Spec("no topic but those under `topics`")] = False

    def check(self) -> None:
        """Refuse bounds that exclude each other.

        Raises:
            InvalidValueError: if they do.
        """
        _check_order(self, "min_duration", "max_duration")


class TopicRules(NamedTuple):
    """Rules of one topic."""

    required: Annotated[bool, Spec("false: the other rules hold only if the bag has a message of the topic")] = True
    type: Annotated[str, Spec("pkg/msg/Type")] = ""
    min_count: Annotated[int, Spec("messages", minimum=0, maximum=_MAX_COUNT)] = 0
    max_count: Annotated[int, Spec("messages", minimum=0, maximum=_MAX_COUNT)] = _MAX_COUNT
    min_rate: Annotated[
        float, Spec("intervals over the time from first to last message", "Hz", minimum=0.0, maximum=_LONG)
    ] = 0.0
    max_rate: Annotated[
        float,
        Spec("intervals over the time from first to last message", "Hz", minimum=0.0, maximum=_LONG, allow_inf=True),
    ] = math.inf
    max_gap: Annotated[
        float, Spec("time between neighbouring messages", "s", minimum=0.0, maximum=_LONG, allow_inf=True)
    ] = math.inf
    max_stamp_gap: Annotated[
        float,
        Spec(
            "step from one stamp to the next, however late they were recorded",
            "s",
            minimum=0.0,
            maximum=_LONG,
            allow_inf=True,
        ),
    ] = math.inf
    max_start: Annotated[
        float,
        Spec("from the first message of the bag to that of the topic", "s", minimum=0.0, maximum=_LONG, allow_inf=True),
    ] = math.inf
    max_end: Annotated[
        float,
        Spec("from the last message of the topic to that of the bag", "s", minimum=0.0, maximum=_LONG, allow_inf=True),
    ] = math.inf
    max_lost: Annotated[int, Spec("lost messages, as `lost` of `diffbot bag info`", minimum=0, maximum=_MAX_COUNT)] = (
        _MAX_COUNT
    )
    min_latency: Annotated[
        float,
        Spec("smallest log time minus stamp; negative: a stamp of the future", "s", minimum=-_LONG, maximum=_LONG),
    ] = 0.0
    max_latency_median: Annotated[
        float, Spec("median of log time minus stamp", "s", minimum=-_LONG, maximum=_LONG, allow_inf=True)
    ] = math.inf
    max_latency_p99: Annotated[
        float, Spec("99 % quantile of log time minus stamp", "s", minimum=-_LONG, maximum=_LONG, allow_inf=True)
    ] = math.inf
    stamped: Annotated[bool, Spec("true: no message without a stamp other than 0")] = False
    monotone_stamps: Annotated[bool, Spec("true: no stamp before that of the message before")] = False
    reliability: Annotated[str, Spec("that every publisher offered", choices=("reliable", "best_effort"))] = "reliable"
    durability: Annotated[str, Spec("that every publisher offered", choices=("volatile", "transient_local"))] = (
        "volatile"
    )
    min_nis_inside: Annotated[
        float, Spec("share of the mean NIS within their 95 % bounds", minimum=0.0, maximum=1.0)
    ] = 0.0
    min_white: Annotated[
        float, Spec("share of the autocorrelations of innovations within their 95 % bounds", minimum=0.0, maximum=1.0)
    ] = 0.0

    def check(self) -> None:
        """Refuse bounds that exclude each other.

        Raises:
            InvalidValueError: if they do.
        """
        _check_order(self, "min_count", "max_count")
        _check_order(self, "min_rate", "max_rate")


def _check_order(rules: Any, low: str, high: str) -> None:
    smallest, largest = getattr(rules, low), getattr(rules, high)
    if smallest > largest:
        raise InvalidValueError(low, smallest, f"<= {high} = {largest!r}")


class Chosen(NamedTuple):
    """Rules, and which of them a contract names: only those are checked."""

    rules: Any
    """BagRules or TopicRules"""
    names: tuple[str, ...]
    """in the order of the rules' definition"""


class Contract(NamedTuple):
    """A checked contract."""

    bag: Chosen
    topics: Mapping[str, Chosen]
    """by topic, in the order of the file"""
    forbidden: tuple[str, ...]
    """topics of which the bag has no message"""


def read_contract(path: Path) -> Contract:
    """Read a contract.

    Raises:
        DiffbotError: in one line: a file that cannot be read, an unknown key, a value that is not allowed.
    """
    name = shown(path)
    return parse_contract(load_yaml(read_text(path, MAX_BYTES), name, unique_keys=True), name)


def parse_contract(content: Any, name: str) -> Contract:
    """Make a contract from the content of a YAML document.

    Args:
        content: the document.
        name: of the file, for the error.

    Raises:
        DiffbotError: as for :func:`read_contract`.
    """
    sections = _map(content, f"{name}: the contract")
    for key in sections:
        if key not in _SECTIONS:
            raise DiffbotError(f"{name}: {_key(key)} is unknown: must be one of {', '.join(_SECTIONS)}")
    version = sections.get("version")
    if version != VERSION or isinstance(version, bool):
        raise DiffbotError(f"{name}: version = {_key(version)}: must be {VERSION}")
    given = _map(sections.get("topics"), f"{name}: topics")
    if len(given) > MAX_TOPICS:
        raise DiffbotError(f"{name}: topics has {len(given)} entries: must be <= {MAX_TOPICS}")
    topics = {
        _topic(topic, f"{name}: topics"): _chosen(TopicRules, rules, f"{name}: {topic}")
        for topic, rules in given.items()
    }
    forbidden = sections.get("forbidden") or []
    if not isinstance(forbidden, list):
        raise DiffbotError(f"{name}: forbidden = {_key(forbidden)}: must be a list of topics")
    banned = tuple(_topic(topic, f"{name}: forbidden") for topic in forbidden)
    for topic in banned:
        if topic in topics:
            raise DiffbotError(f"{name}: {topic} is under topics and under forbidden: must be in one of them")
    return Contract(_chosen(BagRules, sections.get("bag"), f"{name}: bag"), topics, banned)


def _chosen(kind: type[R], content: Any, place: str) -> Chosen:
    values = _map(content, place)
    for key, value in values.items():
        if key not in kind._fields:  # type: ignore[attr-defined]
            names = ", ".join(kind._fields)  # type: ignore[attr-defined]
            raise DiffbotError(f"{place}: {_key(key)} is unknown: must be one of {names}")
        if len(repr(value)) > MAX_TEXT:
            raise DiffbotError(f"{place}: {key} has a value of {len(repr(value))} characters: must be <= {MAX_TEXT}")
    try:
        rules = build(kind, values)
    except InvalidValueError as error:
        raise DiffbotError(f"{place}: {error}") from error
    return Chosen(rules, tuple(name for name in kind._fields if name in values))  # type: ignore[attr-defined]


def _map(content: Any, place: str) -> dict[Any, Any]:
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise DiffbotError(f"{place} = {_key(content)}: must be a map")
    return content


def _topic(name: Any, place: str) -> str:
    if not isinstance(name, str) or len(name) > MAX_TEXT or not _TOPIC.fullmatch(name):
        raise DiffbotError(f"{place}: {_key(name)}: must be the full name of a topic, such as /odom")
    return name


def _key(value: Any) -> str:
    return shown(repr(value))
