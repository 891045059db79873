"""The report of ``diffbot check``: facts about each topic and node, and what to do. Does not import ROS."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

from diffbot_control.filter.config import GLOBAL_POSE
from diffbot_control.goals import states as goal_states
from diffbot_control.ros.input_watch import CONTRADICTED, SILENT, WAITING
from diffbot_control.ros.sensors import DockSensor, FixSensor, LandmarkSensor
from diffbot_core.endpoints import (
    AUTO,
    TWIST,
    TYPE_WORDS,
    Endpoint,
    command_problem,
    followed_type,
    input_problem,
    is_observer,
)
from diffbot_tools.check.streams import COMMANDS, SIMULATED_CLOCK, Stream, Streams

_MAX_AHEAD, _MAX_BEHIND = 0.1, 1.0
"""[s] largest times by which stamps may be ahead of the clock and behind the clock; correct stamps are never ahead"""
_MAX_REPEATED = 0.2
"""largest share of messages without a later stamp"""
_REMEDIES = {
    WAITING: "it has no start pose: publish a fix, or set the pose on initialpose (2D Pose Estimate in RViz)",
    SILENT: "it receives no odometry: look at the driver of the base",
    CONTRADICTED: "it publishes no pose: its inputs contradict each other",
    goal_states.WAITING: "it receives no pose: look at the ekf",
    goal_states.STALE: "it receives no pose: look at the ekf",
}
"""What to do about a node in a state in which the robot cannot drive."""


class TopicGraph(NamedTuple):
    """Publishers and subscriptions of one topic."""

    topic: str
    """full name"""
    type: str = ""
    """type of an input that the ekf reads"""
    publishers: Sequence[Endpoint] = ()
    subscriptions: Sequence[Endpoint] = ()
    elsewhere: Collection[str] = ()
    """other topics of the same type: published topics for an input, subscribed topics for the commands"""

    @property
    def is_latched(self) -> bool:
        """True if a publisher sends its newest message to late subscribers."""
        return any(one.is_latched for one in self.publishers)


class ObservedRobot(NamedTuple):
    """Running nodes of the robot, and their parameters."""

    ekf: str = ""
    """full name of the node; empty if the node does not run"""
    controller: str = ""
    """full name of the node; empty if the node does not run"""
    cmd_vel_type: str = AUTO
    pose_timeout: float = 0.5
    """[s]"""
    max_cmd_vel_publishers: int = 1
    use_sim_time: Mapping[str, bool] = {}
    """parameter of each node that has answered, by the full name of the node"""


class Line(NamedTuple):
    """The report about one topic or node."""

    name: str
    facts: tuple[str, ...] = ()
    todo: tuple[str, ...] = ()
    """faults, each with what to do"""
    notes: tuple[str, ...] = ()
    """information that requires no action"""

    def text(self) -> str:
        """Return the line, with its faults and notes below."""
        mark = "TO DO" if self.todo else "note " if self.notes else "ok   "
        head = f"{mark} {self.name}{': ' * bool(self.facts)}{', '.join(self.facts)}"
        return "\n      ".join((head, *self.todo, *self.notes))


def input_lines(
    graphs: Mapping[str, TopicGraph], streams: Streams, robot: ObservedRobot, duration: float
) -> list[Line]:
    """Return a line for each input of the ekf that is used or published; the odometry comes first.

    Args:
        graphs: publishers and subscriptions, by the name that the ekf gives the topic.
        streams: received messages.
        robot: running nodes.
        duration: [s] duration of the check.
    """
    source, sensors = streams.config.odometry_source, streams.sensors
    fixes = [name for name, one in sensors.items() if isinstance(one, FixSensor | LandmarkSensor | DockSensor)]
    required = {source, *(["imu"] if "imu" in sensors else [])}
    if not any(streams.stream(name).arrivals for name in fixes):
        required.update(fixes)
    # Every ekf subscribes to global_pose and heading. A parameter configures each of the other sensors.
    configured = required | (sensors.keys() - {GLOBAL_POSE, "heading"})
    if streams.config.noise.heading_sigma > 0.0:
        configured.add("heading")
    names = [source, *(name for name in graphs if name != source)]
    # The ekf reads only one of odom and joint_states.
    unused = {"odom", "joint_states"} - {source, *sensors}
    shown = [name for name in names if name not in unused and (name in required or graphs[name].publishers)]
    return [
        _input_line(name, graphs[name], streams, robot, duration, is_configured=name in configured) for name in shown
    ]


def _input_line(
    name: str, graph: TopicGraph, streams: Streams, robot: ObservedRobot, duration: float, *, is_configured: bool
) -> Line:
    stream, source, faults = streams.stream(name), streams.config.odometry_source, streams.faults()
    ekf = Endpoint("/ekf", graph.type, streams.config.reliable_inputs)
    is_subscribed = any(one.node == robot.ekf for one in graph.subscriptions)
    todo = unmatched(graph, graph.subscriptions if is_subscribed else [*graph.subscriptions, ekf])
    notes = [stream.note] if stream.note else []
    if not stream.arrivals and not todo:
        silence = f"no message was received from {_nodes(graph.publishers)}"
        if is_configured:
            todo.append(f"{silence}: look at its log and its device")
        else:
            notes.append(f"{silence}: the sensor may be switched off, and the ekf does not need it")
    todo += stream_problems(graph.topic, stream, is_latched=graph.is_latched)
    todo += [faults[name]] if name in faults else []
    if name == source:
        # Faults between two inputs, such as wheels and gyro, belong to the odometry.
        todo += [text for key, text in faults.items() if key not in streams.sensors and key != source]
        if stream.gap > robot.pose_timeout:
            todo.append(
                f"the longest gap between two messages is {stream.gap:.2f} s, and the robot is stopped after "
                f"pose_timeout = {robot.pose_timeout:g} s: publish at 10 Hz or more, or raise pose_timeout"
            )
    if name == source == "odom":
        todo += too_many_publishers(graph, "measure the motion")
    if stream.arrivals and name not in streams.sensors and name != source:
        notes.insert(0, "the ekf does not use it" + (": set use_gyro" if name == "imu" else ""))
    return Line(graph.topic, facts_of(graph, stream, duration), tuple(dict.fromkeys(todo)), tuple(notes))


def output_lines(
    graphs: Mapping[str, TopicGraph], streams: Streams, robot: ObservedRobot, duration: float
) -> list[Line]:
    """Return a line for each output; the arguments are the same as of :func:`input_lines`."""
    lines = []
    for name, graph in graphs.items():
        facts = facts_of(graph, streams.stream(name), duration)
        todo = too_many_publishers(graph, "publish it", robot.max_cmd_vel_publishers if name == COMMANDS else 1)
        if name == COMMANDS:
            todo += _command_problems(graph, streams, robot)
        elif graph.publishers:
            todo += unmatched(graph, graph.subscriptions)
        else:
            facts = ("no node publishes it yet",)
        lines.append(Line(graph.topic, facts, tuple(todo)))
    return lines


def _command_problems(graph: TopicGraph, streams: Streams, robot: ObservedRobot) -> list[str]:
    own = next((one for one in graph.publishers if one.node == robot.controller), None)
    if own is None:
        # The publisher that the controller will have when it is started.
        types = {word: name for name, word in TYPE_WORDS.items()}
        own = Endpoint(
            "/controller", types.get(robot.cmd_vel_type) or followed_type(TWIST, graph.subscriptions), is_reliable=True
        )
    problem = command_problem(graph.topic, own, graph.subscriptions, graph.elsewhere) or streams.command_fault()
    return [problem] if problem else []


def clock_lines(graph: TopicGraph, streams: Streams, robot: ObservedRobot) -> list[Line]:
    """Return a line for /clock if it is published or wrongly used; ``graph`` has its publishers."""
    todo, clocks = too_many_publishers(graph, "publish the time"), streams.clocks()
    inputs = [name for name in (streams.config.odometry_source, *streams.sensors) if name in clocks]
    is_simulated = dict(robot.use_sim_time) | {
        f"the source of {name}": clocks[name] == SIMULATED_CLOCK for name in inputs
    }
    simulated = ", ".join(name for name, one in is_simulated.items() if one)
    real = ", ".join(name for name, one in is_simulated.items() if not one)
    if simulated and not graph.publishers:
        todo.append(f"{simulated} set use_sim_time, but no node publishes /clock: start the simulation, or unset it")
    elif simulated and real:
        todo.append(
            f"{simulated} follow /clock, but {real} follow the system clock: set use_sim_time in all nodes or in none"
        )
    if not todo and not graph.publishers:
        return []
    return [Line(graph.topic, (f"from {_nodes(graph.publishers)}",), tuple(todo))]


def node_lines(
    states: Mapping[str, tuple[int, str]], copies: Mapping[str, int], unread: Collection[str], todo: Collection[str]
) -> list[Line]:
    """Return a line for each of the robot's nodes.

    Args:
        states: level and message in /diagnostics, by the full name of the node.
        copies: number of nodes with each full name.
        unread: nodes whose parameters could not be read.
        todo: faults of the other lines, which are not repeated.
    """
    lines = []
    for name, count in copies.items():
        level, message = states.get(name, (0, "runs, but publishes no /diagnostics" if count else "does not run"))
        state, *parts = message.split("; ")
        problems = [one for one in parts if level and one != "ok" and "messages dropped in the last" not in one]
        new = [one for one in problems if not any(_cause(one) in text for text in todo)]
        if count > 1:
            new.insert(0, f"{count} nodes have this name: end all but one (ps, or ros2 node list)")
        notes = [] if count else [f"start it: diffbot run {name.rpartition('/')[2]}, or both: diffbot run robot"]
        if level and state in _REMEDIES and not new:
            if problems:
                notes.append("a line above names the cause")
            else:
                new.append(_REMEDIES[state])
        if name in unread:
            notes.append(
                "its parameters could not be read; the parameter file or the defaults were assumed: check again"
            )
        lines.append(Line(name, (state,), tuple(new), tuple(notes)))
    return lines


def _cause(problem: str) -> str:
    """Return the cause in a problem of /diagnostics: ``wrong frame_id`` in ``drops odom: wrong frame_id``."""
    return problem.rpartition("drops ")[2].split(": ", 1)[-1]


def facts_of(graph: TopicGraph, stream: Stream, duration: float) -> tuple[str, ...]:
    """Return type, rate, latency, clock, frames, covariance, publishers and subscribers of a topic in words."""
    count, (clock, age) = len(stream.arrivals), stream.clock()
    facts = [
        "/".join(sorted({one.short_type for one in graph.publishers})),
        f"{stream.rate:.1f} Hz" if count > 1 else f"{count} messages in {duration:.0f} s",
    ]
    if clock:
        facts += [f"latency {age:.3f} s" if abs(age) < 1.0 else f"latency {age:.1f} s", clock]
    facts += [
        " and ".join(map(repr, stream.frames)) if any(stream.frames) else "",
        stream.covariance,
        "latched" if graph.is_latched else "",
        f"from {_nodes(graph.publishers)}",
        f"to {_nodes(one for one in graph.subscriptions if not is_observer(one.node))}",
    ]
    return tuple(filter(None, facts))


def _nodes(endpoints: Iterable[Endpoint]) -> str:
    return ", ".join(sorted({one.node for one in endpoints})) or "nobody"


def unmatched(graph: TopicGraph, subscriptions: Iterable[Endpoint]) -> list[str]:
    """Return why nodes other than observers miss the messages of a publisher, each reason once."""
    robots = [one for one in subscriptions if not is_observer(one.node)]
    problems = []
    for source in [[one] for one in graph.publishers] or [[]]:
        for node in dict.fromkeys(one.node for one in robots):
            # Two subscriptions of one node may differ, such as the latched one of the ekf before the first fix.
            own = [one for one in robots if one.node == node]
            found = [input_problem(graph.topic, one, source, graph.elsewhere) for one in own]
            problems += found[:1] if all(found) else []
    return list(dict.fromkeys(problems))


def too_many_publishers(graph: TopicGraph, role: str, allowed: int = 1) -> list[str]:
    """Return a fault if a topic has more publishers than ``allowed``; ``role`` completes "only one may"."""
    count, words = len(graph.publishers), "one" if allowed == 1 else str(allowed)
    if count <= allowed:
        return []
    return [f"{count} publishers, only {words} may {role}: end or remap all but {words} of {_nodes(graph.publishers)}"]


def stream_problems(name: str, stream: Stream, *, is_latched: bool) -> list[str]:
    """Return the faults that the messages of an input show; the messages of a latched topic may be old."""
    count, found = len(stream.arrivals), []
    for kind, number in stream.drops.items():
        # Messages are dropped until the first transforms arrive; that is not a fault.
        if "no transform" not in kind or number == count:
            found.append(f"the ekf drops {number} of {count} messages: {stream.drop_texts[kind]}")
    if count > 1 and stream.repeated > _MAX_REPEATED * count:
        found.append(
            f"the stamps of {stream.repeated} of {count} messages are not later than earlier stamps: end the second "
            f"publisher of {name}, or correct the stamps of its driver"
        )
    clock, age = stream.clock()
    if -age > _MAX_AHEAD:
        found.append(f"stamped {-age:.2f} s ahead of the {clock} of this computer: synchronise the clocks (chrony)")
    elif age > _MAX_BEHIND and not is_latched:
        found.append(
            f"stamped {age:.2f} s behind the {clock} of this computer: synchronise the clocks (chrony), or publish "
            "sooner"
        )
    return found
