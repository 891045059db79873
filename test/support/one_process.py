"""Nodes in the process of the test, where a start takes milliseconds and a callback can be looked into."""

import contextlib

import graph
from rclpy.parameter import Parameter

from diffbot_core.ros.node import make_executor


class Nodes:
    """Nodes that share the executor of the test's own node."""

    def __init__(self, peer):
        self.peer = peer
        self._nodes = []

    def add(self, kind, parameters=None, arguments=(), **options):
        """Create a node of class ``kind``.

        Args:
            kind: a class of nodes.
            parameters: name to value.
            arguments: ROS arguments, such as ``("-r", "__ns:=/other")``.
            options: of the class.
        """
        overrides = [Parameter(name, value=value) for name, value in (parameters or {}).items()]
        node = kind(
            context=self.peer.context,
            parameter_overrides=overrides,
            cli_args=["--ros-args", *arguments],
            **options,
        )
        self._nodes.append(node)
        self.peer.add_node(node)
        return node

    def remove(self, node):
        """Take a node out of the graph."""
        self.peer.remove_node(node)
        self._nodes.remove(node)
        node.destroy_node()

    def close(self):
        """Destroy the nodes."""
        for node in list(self._nodes):
            self.remove(node)


@contextlib.contextmanager
def nodes(**options):
    """Have nodes in this process while the ``with`` block lasts; ``options`` are those of the test's own node."""
    with graph.peer(executor=make_executor, **options) as peer:
        running = Nodes(peer)
        try:
            yield running
        finally:
            running.close()
