"""Everything of a bag that the page shows, read in one pass: numbers as tables, texts with their times."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_bag.bag.number_rows import LAYOUTS, Layout, NumberRows, labelled_layout, labels_of
from diffbot_bag.bag.reader import BagReader
from diffbot_bag.mcap.attachments import Parameters
from diffbot_bag.tools.bag_info import TopicInfo, info_of
from diffbot_core.cdr import CdrError
from diffbot_tools.bag.unfinished_bags import print_warning
from diffbot_tools.view.footprint import Box, read_footprint
from diffbot_tools.view.landmarks import CloudRows, Measured
from diffbot_tools.view.plans import Plan, PlanRows
from diffbot_tools.view.robot_topics import (
    CLOUD,
    COMMON,
    LOG,
    PATH,
    STATUS,
    STATUSES,
    STRING,
    TRANSFORMS,
    RobotTopics,
    robots_in,
)
from diffbot_tools.view.texts import read_log, read_status, read_statuses
from diffbot_tools.view.transforms import TransformRows

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_POSE = {"x": 0, "y": 1, "qx": 3, "qy": 4, "qz": 5, "qw": 6}
_COVARIANCE = {"xx": 7, "xy": 8, "xt": 12, "yy": 14, "yt": 18, "tt": 42}
"""of x, y and theta (t)"""
_TWIST_OF_ODOMETRY = {"v": 43, "omega": 48}
"""Places of these numbers in the messages, after the texts."""
QUATERNION = ("qx", "qy", "qz", "qw")
LAW_COLUMNS = ("stamp", "rho", "alpha", "beta", "theta", "eps_P", "region", "V")
MAX_TEXTS = 200_000
"""messages with texts that are kept of one topic; later ones are counted"""

MAX_DESCRIPTIONS = 3
"""of a robot that are read"""


class Table(NamedTuple):
    """The messages of one topic as columns."""

    stamps: Stamps
    """(n,) [ns], increasing"""
    log_times: Stamps
    """(n,) [ns]"""
    numbers: Array
    """(n, k)"""
    names: tuple[str, ...]
    """(k,) of the columns"""
    type: str

    def of(self, *names: str) -> Array:
        """Return columns (n, len(names))."""
        return self.numbers[:, [self.names.index(name) for name in names]]


class Timed(NamedTuple):
    """A message with texts."""

    log_time: int
    """[ns]"""
    content: Any


class RobotTables(NamedTuple):
    """What the bag holds of one robot."""

    namespace: str
    tables: dict[str, Table]
    """by role, see robot_topics"""
    texts: dict[str, list[Timed]]
    """by role"""
    transforms: tuple[Stamps, Array]
    """path by /tf: stamps [ns] and poses (n, 3)"""
    plans: list[Plan]
    landmarks: Measured
    box: Box | None
    """of its URDF"""


class BagTables(NamedTuple):
    """A whole bag."""

    robots: list[RobotTables]
    common: dict[str, list[Timed]]
    """/diagnostics and /rosout"""
    topics: list[TopicInfo]
    messages: int
    lost: int | None
    """messages that the recorder reports as lost; None if it reports none of its losses"""
    is_cut_off: bool
    """the bag was not closed"""
    malformed: int
    """messages that could not be read"""
    parameters: Parameters
    """of the nodes, if the recorder noted them"""


class _Texts:
    """Collects the messages of a topic with texts, and those that are none."""

    def __init__(self, read: Callable[[bytes], Any]) -> None:
        self._read = read
        self.found: list[Timed] = []
        self.malformed = 0

    def add(self, log_time: int, data: bytes) -> None:
        try:
            content = self._read(data)
        except CdrError:
            self.malformed += 1
            return
        if len(self.found) < MAX_TEXTS:
            self.found.append(Timed(log_time, content))


class _Law:
    """Rows of the law's variables; their labels come with the first message that has them all."""

    def __init__(self) -> None:
        self._rows: NumberRows | None = None
        self._malformed = 0

    def add(self, log_time: int, data: bytes) -> None:
        if self._rows is None:
            try:
                labels = labels_of(data)
                self._rows = NumberRows(labelled_layout(labels), [labels.index(name) for name in LAW_COLUMNS])
            except ValueError:
                self._malformed += 1
                return
        self._rows.add(log_time, data)

    @property
    def malformed(self) -> int:
        return self._malformed + (self._rows.malformed if self._rows else 0)

    def columns(self) -> tuple[Stamps, Stamps, Array]:
        rows = self._rows or NumberRows(labelled_layout(LAW_COLUMNS), range(len(LAW_COLUMNS)))
        return rows.columns()


class _Transforms:
    def __init__(self) -> None:
        self.rows, self.malformed = TransformRows(), 0

    def add(self, _log_time: int, data: bytes) -> None:
        try:
            self.rows.add(data)
        except CdrError:
            self.malformed += 1


class _Description:
    """Takes the first footprint; a description is latched, so that a few are enough."""

    def __init__(self) -> None:
        self.box: Box | None = None
        self.malformed, self._left = 0, MAX_DESCRIPTIONS

    def add(self, _log_time: int, data: bytes) -> None:
        self._left -= 1
        if self.box is None and self._left >= 0:
            try:
                self.box = read_footprint(data)
            except CdrError:
                self.malformed += 1


def read_tables(path: Path) -> BagTables:
    """Read a bag, with a progress bar on a terminal.

    Raises:
        DiffbotError: if it is no bag, or is damaged.
    """
    with BagReader(path) as reader:
        print_warning(reader)
        types = {topic.name: topic.type for topic in reader.topics.values()}
        robots = robots_in(types)
        collectors: dict[str, list[Any]] = {name: [] for name in types}
        by_robot = [_collect(robot, types, collectors) for robot in robots]
        common = _collect(
            RobotTopics("", {name: name for name in COMMON if types.get(name) == COMMON[name]}), types, collectors
        )
        observers = {name: [one.add for one in many] for name, many in collectors.items()}
        with tqdm(
            desc=path.name, total=reader.message_count, unit="message", unit_scale=True, disable=None, delay=1.0
        ) as bar:
            info = info_of(reader, observers, bar.update)
        parameters, is_cut_off = reader.node_parameters(), bool(reader.warning)
    malformed = sum(one.malformed for many in collectors.values() for one in many)
    found = [_tables(robot, roles, types) for robot, roles in zip(robots, by_robot, strict=True)]
    texts = _tables(RobotTopics("", {}), common, types).texts
    return BagTables(
        found, texts, list(info.topics), info.message_count, info.recorder_lost, is_cut_off, malformed, parameters
    )


def _collect(robot: RobotTopics, types: dict[str, str], collectors: dict[str, list[Any]]) -> dict[str, Any]:
    """Make the collectors of a robot's topics; return them by role."""
    made = {}
    for role, topic in robot.names.items():
        made[role] = _collector(role, types[topic])
        collectors[topic].append(made[role])
    return made


def _collector(role: str, type_name: str) -> Any:
    readers = {STATUS: read_status, STATUSES: read_statuses, LOG: read_log}
    if type_name in readers:
        return _Texts(readers[type_name])
    makers = {TRANSFORMS: _Transforms, STRING: _Description, PATH: PlanRows, CLOUD: CloudRows}
    if type_name in makers:
        return makers[type_name]()
    if role == "law":
        return _Law()
    layout: Layout = LAYOUTS[type_name]
    return NumberRows(layout, tuple(_places(role, type_name).values()))


def _places(role: str, type_name: str) -> dict[str, int]:
    """Return the numbers that are read of a topic; of hours of 50 Hz, each costs megabytes."""
    if role == "law":
        return {name: index for index, name in enumerate(LAW_COLUMNS)}
    if role == "command":
        return {"v": 0, "omega": 5}
    places, numbers = dict(_POSE), LAYOUTS[type_name].numbers
    if role == "estimate":
        places |= _COVARIANCE
    elif role == "truth" and numbers > 7:
        places["tt"] = _COVARIANCE["tt"]
    if role in ("truth", "odometry") and numbers == 85:
        places |= _TWIST_OF_ODOMETRY
    return places


def _tables(robot: RobotTopics, made: dict[str, Any], types: dict[str, str]) -> RobotTables:
    tables, texts, transforms = {}, {}, (np.empty(0, np.int64), np.empty((0, 3)))
    plans, landmarks, description = PlanRows(), CloudRows(), _Description()
    for role, collector in made.items():
        if isinstance(collector, PlanRows):
            plans = collector
        elif isinstance(collector, CloudRows):
            landmarks = collector
        elif isinstance(collector, _Description):
            description = collector
        elif isinstance(collector, _Texts):
            texts[role] = sorted(collector.found, key=lambda one: one.log_time)
        elif isinstance(collector, _Transforms):
            transforms = collector.rows.path()
        else:
            stamps, log_times, numbers = collector.columns()
            type_name = types[robot.names[role]]
            tables[role] = Table(stamps, log_times, numbers, tuple(_places(role, type_name)), type_name)
    marks = landmarks.measured()
    return RobotTables(robot.namespace, tables, texts, transforms, plans.found, marks, description.box)
