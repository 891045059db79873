"""Hostile messages and parameter calls on ekf, controller and plant, each fed by the test."""

import itertools

import pytest
from filter_input import START, fix, heading, odometry, timed
from geometry_msgs.msg import Twist, Vector3
from hostile import parameter_call, spoiled
from nav_msgs.msg import Path
from rcl_interfaces.srv import ListParameters
from repeated import tried
from robot import pose_stamped
from std_srvs.srv import Trigger

NODES = ("ekf", "controller", "plant")
REMAPPED = {
    "ekf": ("odom", "global_pose", "initialpose", "heading", "landmarks"),
    "controller": ("pose", "odometry/filtered", "goal_pose", "path"),
    "plant": ("cmd_vel",),
}
"""Inputs of each node, which the test publishes under other names."""
RECEIVED_SHARE = 0.9
"""Share of the hostile messages that the nodes have to have handled for the test to count."""
BATCH = 500
BURST = 12
"""Messages on each topic between two spins of the executor, fewer than the queues hold."""


def path(time):
    message = timed(Path(), time)
    message.header.frame_id = "map"
    message.poses = [pose_stamped(number, 0.0, 0.0) for number in range(4)]
    return message


def command(_time):
    return Twist(linear=Vector3(x=0.4))


MAKERS = {
    "odom": odometry,
    "global_pose": fix,
    "initialpose": fix,
    "heading": heading,
    "pose": fix,
    "goal_pose": lambda time: timed(pose_stamped(50.0, 1.0, 1.0), time),
    "path": path,
    "cmd_vel": command,
}


class Target:
    """The three nodes, the publishers of their inputs, and a clock that advances with each message."""

    def __init__(self, witness):
        self.witness, self.peer = witness, witness.peer
        self.publishers = {
            topic: self.peer.publisher(type(make(START)), f"in/{topic}", 100) for topic, make in MAKERS.items()
        }
        self.peer.wait_for_subscribers(*self.publishers.values())
        self._ticks = itertools.count()
        self.sent = 0
        """number of all messages, good and hostile"""

    def make(self, topic):
        return MAKERS[topic](round(START + 0.002 * next(self._ticks), 3))

    def send(self, topic, message):
        self.publishers[topic].publish(message)
        self.sent += 1

    def flood(self, count, rng, make):
        """Send ``count`` hostile messages, which ``make`` returns for a good message, and good messages in between."""
        topics = list(self.publishers)
        left = count
        while left > 0:
            for topic in topics[:left] * min(BURST, max(left // len(topics), 1)):
                self.send(topic, make(self.make(topic)))
                left -= 1
                if rng.random() < 0.3:
                    self.send(topic, self.make(topic))
            self.peer.spin_until_quiet(0.01)

    def handled(self):
        """Return the number of messages that the nodes report as received or dropped."""
        return sum(
            int(value)
            for name in NODES
            for key, value in self.witness.robot.diagnosis(name).items()
            if " dropped: " in key or key.endswith(" received")
        )

    def works(self):
        """Check that the filter, the controller and the plant answer good messages."""
        peer, witness = self.peer, self.witness
        poses, truths = witness.robot.poses, witness.truths
        peer.call(Trigger, "ekf/reset")
        before = len(poses), len(witness.commands), len(truths)

        def answered():
            for topic in ("global_pose", "odom", "goal_pose", "pose", "cmd_vel"):
                self.send(topic, self.make(topic))
            peer.spin_for(0.1)
            moves = any(v == pytest.approx(0.4, abs=0.1) for _, (v, _) in truths[before[2] :])
            return len(poses) > before[0] and len(witness.commands) > before[1] and moves

        peer.spin_until(answered, what="answers to good messages")


@pytest.fixture(scope="module")
def target(observed):
    remapped = [f"{name}:{topic}:=in/{topic}" for name, topics in REMAPPED.items() for topic in topics]
    arguments = [word for one in remapped for word in ("-r", one)]
    reliable = {"reliable_inputs": True}
    with observed(None, reliable, reliable, arguments=arguments, joined=True) as witness:
        yield Target(witness)


def alive(target):
    """Return True if all nodes run and have sent only finite numbers."""
    processes = target.witness.robot.processes.values()
    return all(process.popen.poll() is None for process in processes) and not target.witness.non_finite


@tried(100_000, once=300)
def test_hostile_values_leave_nodes_alive_and_outputs_finite(target, trials, seeded):
    handled, sent, left = target.handled(), target.sent, trials.count
    while left > 0:
        target.flood(min(BATCH, left), seeded, lambda good: spoiled(seeded, good))
        assert alive(target)
        left -= BATCH
    enough = handled + RECEIVED_SHARE * (target.sent - sent)
    # Nodes that wait for a processor lose messages from their queues: send others instead.
    while (now := target.handled()) < enough:
        assert now > handled, "the nodes handle no more messages"
        handled = now
        target.flood(BATCH, seeded, lambda good: spoiled(seeded, good))
    target.works()


@tried(3000, once=30)
def test_hostile_parameter_calls_are_answered_and_leave_nodes_alive(target, trials, seeded):
    peer = target.peer
    names = {name: peer.call(ListParameters, f"{name}/list_parameters").result.names for name in NODES}
    for number in trials:
        name = NODES[number % len(NODES)]
        kind, service, request = parameter_call(seeded, names[name])
        topic = seeded.choice(list(target.publishers))
        target.send(topic, target.make(topic))
        peer.call(kind, f"{name}/{service}", request)
        assert alive(target)
