"""The parameters of all nodes in the graph, asked for beside the recording: one node at a time, with a deadline."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.parameter import parameter_value_to_python

from diffbot_bag.bag.topic_selection import is_hidden
from diffbot_bag.mcap.attachments import MAX_ATTACHMENT, Parameters, dump_parameters

DEADLINE = 5.0
"""[s] for the answers of one node"""
ATTACH_PERIOD = 10.0
"""[s] between two attachments, at least: each one contains all nodes"""
MAX_NODES, MAX_PARAMETERS = 200, 2000
"""of the graph, and of a node; more are left out"""


class _Question:
    """What one node is being asked: for the names of its parameters, then for their values."""

    def __init__(self, node: Any, name: str) -> None:
        self.name = name
        self.values: dict[str, Any] | None = None
        """once they are known"""
        self._node = node
        self._end = time.monotonic() + DEADLINE
        self._lister = node.create_client(ListParameters, f"{name}/list_parameters")
        self._getter = node.create_client(GetParameters, f"{name}/get_parameters")
        self._future: Any = None
        self._names: list[str] | None = None

    def is_over(self) -> bool:
        """Go on with the question; return whether it is answered, or the deadline is over."""
        if time.monotonic() > self._end:
            return True
        if self._future is None:
            if self._lister.service_is_ready() and self._getter.service_is_ready():
                self._future = self._lister.call_async(ListParameters.Request())
            return False
        if not self._future.done():
            return False
        answer = self._future.result()
        if self._names is None:
            self._names = list(answer.result.names)[:MAX_PARAMETERS]
            self._future = self._getter.call_async(GetParameters.Request(names=self._names))
            return False
        self.values = dict(_plain(self._names, answer.values))
        return True

    def close(self) -> None:
        """Leave the graph."""
        for client in (self._lister, self._getter):
            self._node.destroy_client(client)


def _plain(names: list[str], values: Any) -> Any:
    for name, value in zip(names, values, strict=False):
        try:
            plain = parameter_value_to_python(value)
        except RuntimeError:  # of an unknown type
            continue
        yield name, plain if plain is None or isinstance(plain, (str, bytes, bool, int, float)) else list(plain)


class NodeParameters:
    """Asks each node once, and again after it has left the graph and returned."""

    def __init__(self, node: Any, attach: Callable[[bytes], None]) -> None:
        """Ask as ``node``; ``attach`` gets the attachment when all nodes were asked, and after changes."""
        self._node, self._attach = node, attach
        self._question: _Question | None = None
        self._asked: set[str] = set()
        self._known: Parameters = {}
        self._changed = False
        self._attached = -ATTACH_PERIOD

    def poll(self) -> None:
        """Go on, for a millisecond or two; called a few times a second."""
        if (question := self._question) is not None:
            if not question.is_over():
                return
            if question.values is not None:
                self._changed = self._changed or self._known.get(question.name) != question.values
                self._known[question.name] = question.values
            question.close()
            self._question = None
            return
        if (name := self._next()) is not None:
            self._asked.add(name)
            self._ask(name)
        elif self._changed and time.monotonic() - self._attached >= ATTACH_PERIOD:
            self.attach()

    def _next(self) -> str | None:
        """Return the full name of a node that was not asked yet."""
        present = {f"{namespace.rstrip('/')}/{name}" for name, namespace in self._node.get_node_names_and_namespaces()}
        self._asked &= present
        new = [name for name in present - self._asked if not is_hidden(name)]
        if not new or len(self._asked) >= MAX_NODES:
            return None
        own = self._node.get_fully_qualified_name()
        return own if own in new else min(new)

    def _ask(self, name: str) -> None:
        if name == self._node.get_fully_qualified_name():
            # No executor has to answer.
            self._known[name] = {one: found.value for one, found in self._node.get_parameters_by_prefix("").items()}
            self._changed = True
            return
        try:
            self._question = _Question(self._node, name)
        except Exception as error:  # rclpy raises several types, such as for a name that is not allowed here
            self._node.get_logger().warning(
                f"the parameters of {name} are not recorded: {' '.join(str(error).split())}"
            )

    def attach(self) -> None:
        """Attach what is known, if it has changed."""
        if not self._changed:
            return
        data = dump_parameters(self._known)
        if len(data) <= MAX_ATTACHMENT:
            self._attach(data)
        self._changed, self._attached = False, time.monotonic()

    def close(self) -> None:
        """Attach what has become known since the last time, and leave the graph."""
        if self._question is not None:
            self._question.close()
            self._question = None
        self.attach()
