"""Request the parameters of all nodes in the graph while recording, one node at a time, with a deadline."""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Callable, Generator, Mapping
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

from diffbot_bag.topic_selection import is_hidden

DEADLINE = 5.0
"""[s] longest time for the answers of one node"""
ATTACH_PERIOD = 10.0
"""[s] shortest time between two attachments, since each one contains the parameters of all nodes"""
MAX_NODES, MAX_PARAMETERS = 200, 2000
"""Largest numbers of nodes, and of parameters of one node, that are recorded."""
HIDDEN = "(not recorded)"
"""Replaces the value of a parameter whose name suggests a secret."""
_SECRET = re.compile(r"passw|secret|token|credential|api_?key|private_?key", re.IGNORECASE)


class NodeParameters:
    """Requests the parameters of each node once, and again if the node leaves the graph and returns.

    A node that does not answer, because it is still starting, is asked once more after all other nodes.
    rclpy's AsyncParameterClient is not used: under SROS2 it needs the permission to set the parameters of all nodes.
    """

    def __init__(self, node: Node, attach: Callable[[bytes], None]) -> None:
        """Prepare to send requests from ``node``; ``attach`` receives the parameters of all nodes as JSON."""
        self._node, self._attach = node, attach
        self._requested: set[str] = set()
        self._slow: set[str] = set()
        """nodes that have not answered in time"""
        self._known: dict[str, dict[str, Any]] = {}
        self._changed = False
        self._attached = -ATTACH_PERIOD
        self._name = ""
        """node whose parameters are being requested"""
        self._request: Generator[None, None, None] | None = None
        self._deadline = 0.0

    def poll(self) -> None:
        """Continue with the requests. Call it a few times a second; it takes one or two milliseconds."""
        if self._request is not None:
            has_ended = next(self._request, self) is self
            is_late = not has_ended and time.monotonic() > self._deadline
            if has_ended or is_late:
                self._request.close()
                self._request = None
            if is_late and self._name not in self._slow:
                self._slow.add(self._name)
                self._requested.discard(self._name)
        elif (name := self._next_node()) is not None:
            self._requested.add(name)
            self._name, self._deadline = name, time.monotonic() + DEADLINE
            self._request = self._request_parameters(name)
        elif time.monotonic() - self._attached >= ATTACH_PERIOD:
            self.attach()

    def _next_node(self) -> str | None:
        """Return the full name of a node whose parameters were not requested yet; None if there is none."""
        present = {f"{namespace.rstrip('/')}/{name}" for name, namespace in self._node.get_node_names_and_namespaces()}
        self._requested &= present
        self._slow &= present
        new = {name for name in present - self._requested if not is_hidden(name)}
        if not new or len(self._requested) >= MAX_NODES:
            return None
        own = self._node.get_fully_qualified_name()
        return own if own in new else min(new, key=lambda name: (name in self._slow, name))

    def _request_parameters(self, name: str) -> Generator[None, None, None]:
        """Request the names and then the values of a node's parameters; yield while waiting for an answer."""
        if name == self._node.get_fully_qualified_name():
            self._add(name, {key: found.value for key, found in self._node.get_parameters_by_prefix("").items()})
            return
        clients: list[Any] = []
        try:
            for kind, service in ((ListParameters, "list_parameters"), (GetParameters, "get_parameters")):
                clients.append(self._node.create_client(kind, f"{name}/{service}"))
            while not all(client.service_is_ready() for client in clients):
                yield
            found = yield from _answer(clients[0], ListParameters.Request())
            names = list(found.result.names)[:MAX_PARAMETERS]
            found = yield from _answer(clients[1], GetParameters.Request(names=names))
            values = [parameter_value_to_python(value) for value in found.values]
            self._add(name, dict(zip(names, values, strict=False)))
        except Exception as error:  # rclpy raises errors of many types, such as for an invalid node name
            reason = " ".join(str(error).split())
            self._node.get_logger().warning(f"cannot record the parameters of {name}: {reason}")
        finally:
            for client in clients:
                self._node.destroy_client(client)

    def _add(self, name: str, values: dict[str, Any]) -> None:
        self._changed = self._changed or self._known.get(name) != values
        self._known[name] = values

    def attach(self) -> None:
        """Attach the known parameters if they have changed."""
        if self._changed:
            self._attach(dump_parameters(self._known))
            self._changed, self._attached = False, time.monotonic()

    def close(self) -> None:
        """Cancel the current request, and attach the parameters if they have changed."""
        if self._request is not None:
            self._request.close()
        self.attach()


def _answer(client: Any, request: Any) -> Generator[None, None, Any]:
    future = client.call_async(request)
    while not future.done():
        yield
    return future.result()


def dump_parameters(parameters: Mapping[str, Mapping[str, Any]]) -> bytes:
    """Return the attachment as JSON: parameter values by node (full name) and by parameter name.

    Byte arrays become hexadecimal text. Infinite numbers and NaN become text, since JSON cannot hold them.
    """
    plain = {
        node: {name: HIDDEN if _SECRET.search(name) else _plain(value) for name, value in values.items()}
        for node, values in parameters.items()
    }
    return (json.dumps(plain, indent=1, allow_nan=False, sort_keys=True) + "\n").encode()


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, bytes):
        return value.hex()
    return [_plain(item) for item in value]
