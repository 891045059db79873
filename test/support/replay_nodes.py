"""A replay in the process of the test, paused until the test's subscriptions are discovered."""

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from recorders import LATCHED
from std_srvs.srv import Trigger

from diffbot_bag.replay_node import ReplayNode


class Replay:
    """A replay, and the messages that subscriptions of the test receive."""

    def __init__(self, nodes, uri, subscribed, arguments=(), **parameters):
        """Start a replay; ``subscribed`` are types and QoS of subscriptions by topic."""
        self.nodes, self.peer, self.topics, self.messages = nodes, nodes.peer, list(subscribed), []
        for topic, (kind, qos) in subscribed.items():
            nodes.peer.node.create_subscription(kind, topic, self._append(topic), qos, raw=True)
        self.reports = nodes.peer.subscribe(DiagnosticStatus, "/replay/status", LATCHED)
        given = {"uri": str(uri), "start_paused": True, "disable_keyboard_controls": True, "wait_timeout": 0.0}
        self.node = nodes.add(ReplayNode, given | parameters, arguments)

    def __enter__(self):
        self.peer.wait_for_publishers(*self.topics)
        for topic in self.topics:
            (publisher,) = [one for one in self.node.publishers if one.topic_name == topic]
            self.peer.spin_until(publisher.get_subscription_count, what=f"a subscriber of {topic}")
        return self

    def __exit__(self, *_):
        self.node.before_shutdown()
        self.nodes.remove(self.node)

    def _append(self, topic):
        return lambda data: self.messages.append((topic, bytes(data)))

    def of(self, topic):
        return [data for name, data in self.messages if name == topic]

    def call(self, name):
        answer = self.peer.call(Trigger, f"/replay/{name}")
        return answer.success, answer.message

    def set(self, **values):
        """Set parameters; return the reason of the last refusal, or an empty text."""
        results = self.node.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        return next((result.reason for result in results if not result.successful), "")

    def wait_for(self, topic, count):
        self.peer.spin_until(lambda: len(self.of(topic)) >= count, what=f"{count} messages of {topic}")

    def wait_for_end(self):
        """Spin until the replay has ended and all messages are received; return its exit status."""
        self.peer.spin_until(lambda: self.node.exit_code is not None, what="the end of the replay")
        count = -1
        while count != len(self.messages):  # this process may have been held up during the wait
            count = len(self.messages)
            self.peer.spin_until_quiet()
        return self.node.exit_code

    def play(self):
        assert self.call("resume") == (True, "playing")
        assert self.wait_for_end() == 0


def play(nodes, uri, subscribed, arguments=(), **parameters):
    with Replay(nodes, uri, subscribed, arguments, **parameters) as replay:
        replay.play()
    return replay
