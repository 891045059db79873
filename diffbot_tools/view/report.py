"""The report of a bag: what the page shows of it, thinned and packed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_bag.tools.bag_info import TopicInfo
from diffbot_control.law.configuration import ControllerConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.kinematics import WheelGeometry
from diffbot_tools.trajectory import Trajectory
from diffbot_tools.view.bag_tables import BagTables, RobotTables, read_tables
from diffbot_tools.view.clock import Clock, Columns
from diffbot_tools.view.constants import constants_of, recorded_config, recorded_wheels
from diffbot_tools.view.events import Event, events_of
from diffbot_tools.view.footprint import Box
from diffbot_tools.view.goals import GoalSent, goals_of
from diffbot_tools.view.landmarks import Landmark, landmarks_on_map
from diffbot_tools.view.packing import Packer
from diffbot_tools.view.plans import Plan, PlanEnd, plan_columns
from diffbot_tools.view.result import goal_rows, health_lines, state_rows
from diffbot_tools.view.signals import NEES_BOUNDS, clock_of, curves_of
from diffbot_tools.view.thinning import kept_rows

Array = NDArray[np.float64]

MAX_ROWS = 40_000
"""of a curve in the page: 13 minutes at 50 Hz are not thinned"""
MAX_LISTED = 2000
"""events of a robot; the page lists as many"""
MAX_TOPICS = 500
"""in the table of topics"""


class RobotRun(NamedTuple):
    """One robot of a bag, at full rate."""

    name: str
    """its namespace without the first slash; ``robot`` without one"""
    curves: dict[str, Columns]
    goals: list[GoalSent]
    events: list[Event]
    plan: Columns
    """see plans.plan_columns"""
    landmarks: list[Landmark]
    states: list[tuple[float, dict[str, Any]]]
    """see result.state_rows"""
    config: ControllerConfig
    """whose tolerances and limits are drawn"""
    wheels: WheelGeometry | None
    """as recorded; None if the recorder noted none"""
    box: Box | None
    """of its URDF"""


class BagRun(NamedTuple):
    """A bag as the report needs it."""

    title: str
    clock: Clock
    robots: list[RobotRun]
    tables: BagTables


@np.errstate(all="ignore")
def read_bag_run(bag: Path, config: ControllerConfig | None = None, is_from_goal: bool = False) -> BagRun:
    """Read a bag; without ``config``, tolerances and limits are those that the recorder noted, or those of ``tuned``.

    A number in the bag may be any: what overflows is inf or nan, and left out of the drawing. Time begins with the
    first pose, or with the first goal, if there is one and ``is_from_goal``.

    Raises:
        DiffbotError: if it cannot be read, or holds no robot's pose.
    """
    tables = read_tables(bag)
    clock = clock_of(tables.robots)
    sent = [goal.time for robot in tables.robots for goal in goals_of(robot, clock)] if is_from_goal else []
    if sent:
        clock = clock._replace(origin=int(clock.stamps_of(np.array(min(sent)))))
    robots = [_robot_run(robot, tables, clock, config) for robot in tables.robots]
    robots = [robot for robot in robots if {"truth", "estimate", "odometry"} & set(robot.curves)]
    if not robots:
        raise DiffbotError(f"{bag}: no pose of a robot in it: no odometry, pose or transform that could be read")
    return BagRun("/".join(bag.resolve().parts[-2:]), clock, robots, tables)


def _robot_run(robot: RobotTables, tables: BagTables, clock: Clock, config: ControllerConfig | None) -> RobotRun:
    config = config or recorded_config(tables.parameters.get(f"{robot.namespace.rstrip('/')}/controller", {}))
    curves = curves_of(robot, clock)
    goals = goals_of(robot, clock)
    events = events_of(robot, curves, goals, tables.common, clock)
    plan = plan_columns([*robot.plans, *_ends_of_plans(robot)], clock)
    landmarks = landmarks_on_map(robot.landmarks, _path_of(curves, clock), clock)
    states = state_rows(robot.texts, clock)
    wheels = recorded_wheels(tables.parameters, robot.namespace.rstrip("/"))
    name = robot.namespace.lstrip("/") or "robot"
    return RobotRun(name, curves, goals, events, plan, landmarks, states, config, wheels, robot.box)


def _ends_of_plans(robot: RobotTables) -> list[Plan]:
    end = PlanEnd()
    return [Plan(time, []) for time, status in robot.texts.get("controller", []) if end.is_over(status.values)]


def _path_of(curves: dict[str, Columns], clock: Clock) -> Trajectory:
    """Return the path by which landmarks are placed; without an estimate, the best that there is."""
    columns = next((curves[name] for name in ("estimate", "truth", "odometry") if name in curves), None)
    if columns is None:
        return Trajectory(np.empty(0, np.int64), np.empty((0, 3)))
    times, first = np.unique(clock.stamps_of(columns["t"]), return_index=True)
    x, y, theta = (columns[name][first] for name in ("x", "y", "theta"))
    return Trajectory(times, np.column_stack((x, y, np.unwrap(theta))))


@np.errstate(all="ignore")
def page_data(run: BagRun, *others: BagRun) -> dict[str, Any]:
    """Return what the page embeds: of one run, or of several that it lays over each other."""
    packer = Packer()
    runs = (run, *others)
    robots = [
        {
            "name": _name(robot, one, number) if others else robot.name,
            "curves": {name: packer.table(_thinned(columns)) for name, columns in robot.curves.items()}
            | {"plan": packer.table(robot.plan)},
            "landmarks": [list(landmark) for landmark in robot.landmarks],
            "goals": [[goal.time, *goal.pose] for goal in robot.goals],
            "events": [event.row for event in _listed(robot.events)],
            "summary": goal_rows(robot.curves, robot.goals, robot.events, robot.config, robot.wheels),
            "health": health_lines(robot.curves, robot.events, NEES_BOUNDS[1], one.tables.lost, one.tables.is_cut_off),
            "states": robot.states,
            "constants": constants_of(robot.config, robot.wheels) | {"nees": NEES_BOUNDS},
            "box": robot.box,
        }
        for number, one in enumerate(runs, 1)
        for robot in one.robots
    ]
    return {
        "kind": "report",
        "isComparison": bool(others),
        "title": " against ".join(one.title for one in runs),
        "origin": run.clock.origin // 10**6,
        "span": _span([robot for one in runs for robot in one.robots]),
        "messages": sum(one.tables.messages for one in runs),
        "malformed": sum(one.tables.malformed for one in runs),
        "robots": robots,
        "topics": [topic_figures(topic) for topic in ([] if others else run.tables.topics[:MAX_TOPICS])],
        "packed": packer.text(),
    }


def _listed(events: list[Event]) -> list[Event]:
    """Return the events that the page lists, without those of details if they are too many."""
    for details in ((), ("switch",), ("switch", "rejection")):
        kept = [event for event in events if event.kind not in details]
        if len(kept) <= MAX_LISTED:
            break
    return kept[:MAX_LISTED]


def _name(robot: RobotRun, run: BagRun, number: int) -> str:
    return f"{number}: {run.title}" + (f" {robot.name}" if len(run.robots) > 1 else "")


def _thinned(columns: Columns) -> Columns:
    watched = np.column_stack([values for name, values in columns.items() if name != "t"])
    kept = kept_rows(watched, MAX_ROWS)
    return {name: values[kept] for name, values in columns.items()}


def _span(robots: list[RobotRun]) -> list[float]:
    times = [columns["t"] for robot in robots for columns in robot.curves.values()]
    # To whole milliseconds, outwards: the slider's text must not end before the last row.
    begin, end = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
    return [math.floor(1000.0 * begin) / 1000.0, math.ceil(1000.0 * end + 0.1) / 1000.0]


def topic_figures(topic: TopicInfo) -> dict[str, Any]:
    """Return number, rate, largest gap and delays of a topic."""
    row: dict[str, Any] = {
        "name": topic.name,
        "type": topic.type,
        "count": topic.message_count,
        "rate": None,
        "gap": None,
    }
    if topic.figures is not None:
        row |= {"rate": topic.figures.rate, "gap": topic.figures.gap}
        if (latency := topic.figures.latency) is not None:
            row |= {"delay": latency.median, "delay99": latency.p99}
    return row
