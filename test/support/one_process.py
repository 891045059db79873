"""Nodes in the process of the test, which start in milliseconds and whose state can be checked."""

import contextlib

import graph
from rclpy.parameter import Parameter

from diffbot_core.ros.run import make_executor


class Nodes:
    """Nodes that share the executor of the test's own node."""

    def __init__(self, peer):
        self.peer = peer
        self._nodes = []

    def add(self, kind, parameters=None, arguments=(), **options):
        """Create a node of class ``kind`` with parameters, ROS arguments and options of its class."""
        overrides = [Parameter(name, value=value) for name, value in (parameters or {}).items()]
        node = kind(
            context=self.peer.context, parameter_overrides=overrides, cli_args=["--ros-args", *arguments], **options
        )
        self._nodes.append(node)
        self.peer.executor.add_node(node)
        return node

    def remove(self, node):
        """End a node as its own process does: destroying the node alone would leave its action servers."""
        node.before_shutdown()
        self.peer.executor.remove_node(node)
        self._nodes.remove(node)
        node.destroy_node()


class Fed:
    """A node that receives messages of the test and has handled a message when :meth:`send` returns."""

    def __init__(self, nodes, kind, parameters=None, arguments=()):
        self.peer = nodes.peer
        self.node = nodes.add(kind, parameters, arguments)
        self._publishers = {}

    def handled(self, topic):
        """Return the number of handled messages of a topic, good or bad, and of failed callbacks."""
        health = self.node.health
        dropped = sum(count for (name, _), count in health.dropped.items() if name == topic)
        return health.accepted[topic] + dropped + health.counted["internal errors"]

    def send(self, topic, message):
        """Publish a message and wait until the node has handled it."""
        if topic not in self._publishers:
            self._publishers[topic] = self.peer.publisher(type(message), topic, 100)
            self.peer.wait_for_subscribers(self._publishers[topic])
        before = self.handled(topic)
        self._publishers[topic].publish(message)
        self.peer.spin_until(lambda: self.handled(topic) > before, what=f"the message on {topic}")


@contextlib.contextmanager
def nodes(**options):
    """Run nodes in this process while the ``with`` block lasts; ``options`` are of the test's own node."""
    with graph.peer(executor=make_executor, **options) as peer:
        running = Nodes(peer)
        try:
            yield running
        finally:
            for node in list(running._nodes):
                running.remove(node)
