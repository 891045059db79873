"""A recorder in the process of the test, where DDS delivers messages at once and the recorder's state can be read."""

from collections import Counter

import bag_makers
import graph
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message

from diffbot_bag.recorder_node import RecorderNode

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEEP = 10_000
DEEP_LATCHED = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)


class Recorder:
    """A recorder on the executor of the test's own node, and its reports."""

    def __init__(self, nodes, folder, arguments=(), **parameters):
        """Start a recorder with these parameters."""
        self.nodes, self.peer = nodes, nodes.peer
        self.reports = nodes.peer.subscribe(DiagnosticStatus, "/recorder/status", LATCHED)
        parameters = {"uri": str(folder), **parameters}
        self.node = nodes.add(RecorderNode, parameters, arguments)

    def value(self, key):
        """Return a value of the newest report."""
        return graph.values(self.reports[-1])[key] if self.reports else ""

    def wait(self, key, expected):
        """Spin until the recorder reports this value."""
        self.peer.spin_until(lambda: self.value(key) == str(expected), what=f"{key} = {expected}")

    def wait_for(self, *publishers):
        """Spin until the recorder and each publisher have discovered each other."""
        wanted = Counter(publisher.topic_name for publisher in publishers)

        def known():
            found = Counter({one.topic_name: one.get_publisher_count() for one in self.node.subscriptions})
            matched = all(publisher.get_subscription_count() for publisher in publishers)
            return matched and wanted <= found and set(wanted) <= set(self.value("topics").split())

        self.peer.spin_until(known, what=f"subscriptions to {set(wanted)}")

    def close(self):
        """End the recorder as its process does: it still writes the received messages."""
        self.node.before_shutdown()
        self.nodes.remove(self.node)


def twists(count, first=0):
    """Yield ``count`` messages with different numbers."""
    message = Twist()
    for index in range(first, first + count):
        message.linear.x = float(index)
        yield message


def publish(publisher, messages):
    """Publish messages; return their bytes, serialized by ROS."""
    sent = []
    for message in messages:
        sent.append(bytes(serialize_message(message)))
        publisher.publish(message)
    return sent


def recorded(folder, topic):
    """Return the bytes of the messages of a topic, read by rosbags."""
    return [data for _, data in bag_makers.read(folder, raw=True).get(topic, ())]
