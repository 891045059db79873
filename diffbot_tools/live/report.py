"""Judges what was observed of each topic: one line with its facts, and what to do. Free of ROS."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from diffbot_control.ros.sensors import DockSensor, FixSensor, LandmarkSensor
from diffbot_core.endpoints import (
    AUTO,
    TWIST,
    TYPE_WORDS,
    Endpoint,
    bases,
    command_problem,
    followed_type,
    input_problem,
    is_observer,
    qos_mismatch,
)
from diffbot_tools.live.streams import COMMANDS, ODOMETRY_TOPICS, Stream, Streams

_MAX_AHEAD, _MAX_BEHIND = 0.1, 1.0
"""[s] by which stamps may be ahead of the clock, which no measurement can be, and behind it"""
_MAX_REPEATED = 0.2
"""share of messages without a later stamp"""


class TopicGraph(NamedTuple):
    """Endpoints of one topic."""

    topic: str
    """its full name"""
    types: tuple[str, ...]
    """of its messages that are possible"""
    publishers: Sequence[Endpoint] = ()
    subscriptions: Sequence[Endpoint] = ()
    elsewhere: Collection[str] = ()
    """other topics of the same type, that are published (of an input), or subscribed (of the commands)"""

    @property
    def is_latched(self) -> bool:
        """True if a late subscriber gets the newest message of a publisher."""
        return any(one.is_latched for one in self.publishers)


class Robot(NamedTuple):
    """What is known about the nodes of the robot."""

    ekf: str = ""
    """full name of the node; empty: it does not run"""
    controller: str = ""
    cmd_vel_type: str = AUTO
    pose_timeout: float = 0.5
    """[s]"""
    use_sim_time: Mapping[str, bool] = {}
    """by the full name of the node"""


class Line(NamedTuple):
    """One topic or node: what was observed, and what has to be done."""

    name: str
    facts: tuple[str, ...] = ()
    todo: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    """what a user may want to know, without a need to do something"""

    def text(self) -> str:
        """Return the line."""
        mark = "TO DO" if self.todo else "note " if self.notes else "ok   "
        return f"{mark} {self.name}{': ' * bool(self.facts)}{', '.join(self.facts)}" + "".join(
            f"\n      {one}" for one in self.todo + self.notes
        )


def facts_of(graph: TopicGraph, stream: Stream, duration: float) -> tuple[str, ...]:
    """Return type, rate, latency, clock, frames, covariance, publishers and subscribers of a topic in words."""
    count = len(stream.arrivals)
    types = sorted({one.short_type for one in graph.publishers})
    facts = ["/".join(types), f"{stream.rate:.1f} Hz" if count > 1 else f"{count} messages in {duration:.0f} s"]
    clock, age = stream.clock()
    if clock:
        facts += [f"latency {age:.3f} s" if abs(age) < 1.0 else f"latency {age:.1f} s", clock]
    facts += [" and ".join(map(repr, stream.frames)) if any(stream.frames) else "", stream.covariance]
    facts += ["latched"] if graph.is_latched else []
    for word, ends in (("from", graph.publishers), ("to", graph.subscriptions)):
        names = sorted({one.node for one in ends if word == "from" or not is_observer(one.node)})
        facts.append(f"{word} {', '.join(names) or 'nobody'}")
    return tuple(filter(None, facts))


def mismatches(graph: TopicGraph) -> list[str]:
    """Return which subscription receives nothing from which publisher, because of type or quality of service."""
    found = []
    for one in graph.publishers:
        for other in graph.subscriptions:
            policy, request = qos_mismatch(one, other)
            if is_observer(other.node):
                continue
            if one.type != other.type:
                found.append(
                    f"{one.node} publishes {graph.topic} as {one.short_type}, {other.node} subscribes to it as "
                    f"{other.short_type}: convert one of them, or remap it"
                )
            elif policy and not (policy == "durability" and one.node == other.node):
                found.append(
                    f"{one.node} does not publish {graph.topic} as {request}, which {other.node} requests: change the "
                    f"{policy} of one of them"
                )
    return list(dict.fromkeys(found))


def stream_problems(name: str, stream: Stream, *, is_latched: bool) -> list[str]:
    """Return what the messages of an input show by themselves; a latched message may be old."""
    count, found = len(stream.arrivals), []
    for kind, number in stream.drops.items():
        text = stream.drop_texts[kind]
        if "no transform" in kind and number < count:
            continue  # while transforms arrive
        found.append(f"the ekf drops {number} of {count} messages: {text}")
    if count > 1 and stream.repeated > _MAX_REPEATED * count:
        found.append(
            f"{stream.repeated} of {count} messages have no later stamp than the messages before: end the second "
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


def sim_time_problems(robot: Robot, streams: Streams, has_clock: bool) -> list[str]:
    """Return which nodes and inputs use another clock than the rest."""
    clocks = {name: stream.clock()[0] == "/clock" for name, stream in streams.streams.items() if stream.ages}
    inputs = {name: is_simulated for name, is_simulated in clocks.items() if name in _inputs(streams)}
    users = dict(robot.use_sim_time) | {f"the source of {name}": one for name, one in inputs.items()}
    simulated, real = ([name for name, one in users.items() if one is wanted] for wanted in (True, False))
    if simulated and not has_clock:
        return [
            f"{', '.join(simulated)} set use_sim_time, but nothing publishes /clock: start the simulation, or unset it"
        ]
    if simulated and real:
        both = f"{', '.join(simulated)} follow /clock, {', '.join(real)} the system clock"
        return [f"{both}: set use_sim_time in all nodes or in none"]
    return []


def _inputs(streams: Streams) -> list[str]:
    return [streams.config.odometry_source, *streams.sensors]


def input_lines(graphs: Mapping[str, TopicGraph], streams: Streams, robot: Robot, duration: float) -> list[Line]:
    """Return a line for each input of the ekf that is used or published; the odometry comes first."""
    config, source = streams.config, streams.config.odometry_source
    is_simulated = any(stream.clock()[0] == "/clock" for stream in streams.streams.values())
    faults, lines = streams.faults(is_simulated=is_simulated), []
    by_topic = {source: [text for key, text in faults.items() if key not in streams.sensors and key != source]}
    fixes = [name for name, one in streams.sensors.items() if isinstance(one, FixSensor | LandmarkSensor | DockSensor)]
    has_fixes = any(streams.stream(name).arrivals for name in fixes)
    for name in (source, *(one for one in graphs if one != source)):
        graph, stream = graphs[name], streams.stream(name)
        if name != source and name not in streams.sensors and name in ODOMETRY_TOPICS:
            continue
        is_needed = name == source or (name in fixes and not has_fixes) or (name == "imu" and name in streams.sensors)
        if not is_needed and not graph.publishers:
            continue
        facts, todo, notes = facts_of(graph, stream, duration), mismatches(graph), []
        own = next((one for one in graph.subscriptions if one.node == robot.ekf and robot.ekf), None)
        own = own or Endpoint("/ekf", graph.types[0], config.reliable_inputs)
        if text := input_problem(graph.topic, own, graph.publishers, graph.elsewhere):
            todo.append(text)
        elif not stream.arrivals:
            names = ", ".join(sorted({one.node for one in graph.publishers}))
            todo.append(f"{names} publishes {graph.topic}, but no message came: look at its log and its device")
        todo += stream_problems(graph.topic, stream, is_latched=graph.is_latched)
        todo += [faults[name]] if name in faults else []
        todo += by_topic.get(name, [])
        if name == source:
            todo += odometry_problems(graph, stream, robot.pose_timeout)
        if name not in streams.sensors and name != source:
            notes.append("the ekf does not use it" + (": set use_gyro" if name == "imu" else ""))
        notes += [stream.note] if stream.note else []
        lines.append(Line(graph.topic, facts, tuple(dict.fromkeys(todo)), tuple(notes)))
    return lines


def odometry_problems(graph: TopicGraph, stream: Stream, pose_timeout: float) -> list[str]:
    """Return what is wrong with rate and number of publishers of the odometry: each message becomes one pose."""
    found = []
    if stream.gap > pose_timeout:
        found.append(
            f"the longest gap between two messages is {stream.gap:.2f} s, and the robot is stopped after "
            f"pose_timeout = {pose_timeout:g} s: publish at 10 Hz or more, or raise pose_timeout"
        )
    if len(graph.publishers) > 1 and graph.topic.rpartition("/")[2] == "odom":
        names = ", ".join(sorted(one.node for one in graph.publishers))
        found.append(f"{len(graph.publishers)} publishers, only one may measure the motion: end one of {names}")
    return found


def output_lines(graphs: Mapping[str, TopicGraph], streams: Streams, robot: Robot, duration: float) -> list[Line]:
    """Return a line for each output; the commands come last."""
    lines = []
    for name, graph in graphs.items():
        stream = streams.stream(name)
        facts, todo = facts_of(graph, stream, duration), list[str]()
        if len(graph.publishers) > 1:
            names = ", ".join(sorted(one.node for one in graph.publishers))
            todo.append(f"{len(graph.publishers)} publishers, only one may publish it: end or remap one of {names}")
        if name == COMMANDS:
            own = next((one for one in graph.publishers if one.node == robot.controller and robot.controller), None)
            kind = next((kind for kind, word in TYPE_WORDS.items() if word == robot.cmd_vel_type), TWIST)
            kind = followed_type(kind, graph.subscriptions) if robot.cmd_vel_type == AUTO else kind
            text = command_problem(
                graph.topic, own or Endpoint("/controller", kind), graph.subscriptions, graph.elsewhere
            )
            todo += [text or streams.command_fault()] if text or streams.command_fault() else []
            if not bases(graph.subscriptions) and not robot.controller:
                facts = ()
        elif graph.publishers:
            todo += mismatches(graph)
        else:
            facts = ("nobody publishes it yet",)
        lines.append(Line(graph.topic, facts, tuple(todo)))
    return lines


def node_lines(states: Mapping[str, tuple[int, str]], copies: Mapping[str, int], known: Collection[str]) -> list[Line]:
    """Return a line for each of the robot's nodes.

    Args:
        states: level and message in /diagnostics, by the full name of the node.
        copies: number of nodes with this name.
        known: what other lines ask for already.
    """
    lines = []
    for name, count in copies.items():
        level, message = states.get(name, (0, "runs, but publishes no /diagnostics" if count else "does not run"))
        state, *parts = message.split("; ")
        parts = [one for one in parts if one != "ok" and "messages dropped in the last" not in one]
        new = [
            one for one in parts if not any(one.rpartition("drops ")[2].split(": ", 1)[-1] in text for text in known)
        ]
        todo = new if level else []
        if count > 1:
            todo.insert(0, f"{count} nodes have this name: end all but one (ps, or ros2 node list)")
        notes = () if count else (f"start it: diffbot run {name.rpartition('/')[2]}, or both: diffbot run robot",)
        lines.append(Line(name, (state,), tuple(todo), notes))
    return lines
