"""Managed nodes: the requests of Nav2's lifecycle manager, and what the robot does meanwhile."""

import contextlib

import graph
import one_process
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetState
from nav_msgs.msg import Odometry
from robot import initialpose, pose_stamped, twist

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ros.message_fields import set_stamp

MANAGED = {"autostart": False}
# Transition and the state in which Nav2's manager then has to find the node, as its startup, pause, resume, reset and
# shutdown ask for them.
SEQUENCE = (
    (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
    (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
    (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
    (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
    (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
    (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED),
    (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
    (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED),
    (Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, State.PRIMARY_STATE_FINALIZED),
)


class Manager:
    """Asks as nav2_lifecycle_manager does: change the state, then look whether it is the expected one."""

    def __init__(self, peer, process):
        self.peer, self.process = peer, process

    def request(self, name, transition=0, label=""):
        """Return whether the node reports success."""
        request = ChangeState.Request(transition=Transition(id=transition, label=label))
        return self.peer.call(ChangeState, f"{name}/change_state", request).success

    def state(self, name):
        return self.peer.call(GetState, f"{name}/get_state").current_state

    def change(self, name, transition, expected):
        assert self.request(name, transition)
        assert self.state(name).id == expected


@contextlib.contextmanager
def managed(module, parameters=None):
    """Run a node that waits for a manager."""
    with graph.peer() as peer, graph.node(module, {**MANAGED, **(parameters or {})}) as process:
        process.wait_for_output("]: ready")
        yield Manager(peer, process)


@pytest.fixture(scope="module")
def robot():
    """Filter and controller in one process, unconfigured."""
    with managed("diffbot_control.robot_node") as manager:
        yield manager


def odometry_message():
    message = Odometry(child_frame_id="base_link")
    message.pose.pose.orientation.w = 1.0
    message.twist.covariance[[0, 35]] = 1e-3
    return message


def send_odometry(peer, odometries, count=1):
    message = odometry_message()
    for _ in range(count):
        set_stamp(message.header.stamp, peer.node.get_clock().now().nanoseconds)
        odometries.publish(message)
        peer.spin_for(0.02)


def drive(peer, odometries, goals, commands):
    """Send goals and odometry until a command to move comes."""

    def moving():
        goals.publish(pose_stamped(5.0, 0.0, 0.0))
        send_odometry(peer, odometries)
        return commands and commands[-1].linear.x > 0.0

    peer.spin_until(moving, 10.0, "a command to drive")


def topics(peer):
    return {name for name, _ in peer.node.get_topic_names_and_types()}


def test_the_whole_sequence_of_a_manager(robot):
    peer = robot.peer
    nodes = ("ekf", "controller")
    events = {name: peer.subscribe(TransitionEvent, f"{name}/transition_event") for name in nodes}
    commands = peer.subscribe(Twist, "cmd_vel")
    peer.wait_for_publishers(*(f"{name}/transition_event" for name in nodes))
    assert "/pose" not in topics(peer)
    for number, (transition, expected) in enumerate(SEQUENCE[:7]):
        # Startup in the order of the manager's list, everything else in the reverse order.
        for name in nodes if transition in (1, 3) else nodes[::-1]:
            robot.change(name, transition, expected)
        if number == 1:
            assert {"/pose", "/odometry/filtered", "/odom", "/goal_pose"} <= topics(peer)
    for name in nodes:
        peer.spin_until(lambda name=name: len(events[name]) >= 14, 5.0, "two events of each transition")
        assert [event.goal_state.label for event in events[name]][:4] == [
            "configuring", "inactive", "activating", "active",
        ]  # fmt: skip
    # One zero for each of the two deactivations.
    peer.spin_until(lambda: len(commands) >= 2, 5.0, "the stop commands")
    assert [twist(command) for command in commands] == [(0.0, 0.0)] * 2


def test_a_deactivated_controller_stops_the_robot_and_starts_idle_again(robot):
    peer = robot.peer
    commands, poses = peer.subscribe(Twist, "cmd_vel"), peer.subscribe(PoseWithCovarianceStamped, "pose")
    odometries, goals = peer.publisher(Odometry, "odom"), peer.publisher(PoseStamped, "goal_pose")
    starts = peer.publisher(PoseWithCovarianceStamped, "initialpose")
    for name in ("ekf", "controller"):
        robot.change(name, Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE)
    peer.wait_for_subscribers(odometries, goals, starts)
    starts.publish(initialpose(0.0, 0.0, 0.0))
    drive(peer, odometries, goals, commands)
    robot.change("controller", Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE)
    peer.spin_until(lambda: twist(commands[-1]) == (0.0, 0.0), 5.0, "the stop")
    peer.spin_until_quiet(0.1)
    before, known = len(commands), len(poses)
    goals.publish(pose_stamped(5.0, 0.0, 0.0))
    send_odometry(peer, odometries, 20)
    assert len(poses) >= known + 10  # the filter goes on
    assert len(commands) == before
    robot.change("controller", Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE)
    send_odometry(peer, odometries, 20)
    assert len(commands) == before  # neither the old goal nor the one it got while inactive
    drive(peer, odometries, goals, commands)
    robot.change("ekf", Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE)
    peer.spin_until_quiet(0.1)
    known = len(poses)
    send_odometry(peer, odometries, 20)
    assert len(poses) == known
    # Without poses the controller has stopped the robot by itself.
    peer.spin_until(lambda: twist(commands[-1]) == (0.0, 0.0), 5.0, "the stop for want of poses")


def test_a_transition_that_the_state_does_not_have_is_refused_and_the_node_lives(robot):
    active = robot.state("controller").id
    assert active == State.PRIMARY_STATE_ACTIVE
    for transition, label in ((Transition.TRANSITION_CONFIGURE, ""), (99, ""), (0, "fly"), (0, "configure")):
        assert not robot.request("controller", transition, label)
    assert robot.state("controller").id == active
    assert "no transition fly from active: refused" in robot.process.output
    states = robot.peer.call(GetAvailableStates, "controller/get_available_states").available_states
    assert {"unconfigured", "inactive", "active", "finalized"} <= {state.label for state in states}


def test_shutdown_from_active_stops_the_robot_and_the_process_ends_by_its_signal(robot):
    commands = robot.peer.subscribe(Twist, "cmd_vel")
    robot.peer.wait_for_publishers("cmd_vel")
    assert robot.request("controller", Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert robot.state("controller").id == State.PRIMARY_STATE_FINALIZED
    robot.peer.spin_until(lambda: commands, 5.0, "the stop")
    assert twist(commands[-1]) == (0.0, 0.0)
    for transition, expected in SEQUENCE[5:6]:
        robot.change("ekf", transition, expected)
    robot.change("ekf", *SEQUENCE[8])
    assert robot.process.stop() == 0
    assert "Traceback" not in robot.process.output


def test_a_node_that_cannot_be_configured_stays_unconfigured_and_says_why():
    with managed("diffbot_control.robot_node", {"controller:map_frame": "world"}) as manager:
        assert not manager.request("controller", Transition.TRANSITION_CONFIGURE)
        assert manager.state("controller").id == State.PRIMARY_STATE_UNCONFIGURED
        assert "map_frame: the controller has 'world', the ekf 'map': must be the same" in manager.process.output
        node = manager.peer.node
        manager.peer.spin_until(lambda: not node.get_publishers_info_by_topic("/cmd_vel"), 5.0, "no publisher")
        manager.change("ekf", *SEQUENCE[0])
        assert manager.process.stop() == 0


def test_a_destroyed_node_leaves_no_topic_behind():
    # A name of its own: the peer of the module's robot still subscribes to topics of "controller".
    with one_process.nodes() as nodes:
        node = nodes.add(ControllerNode, arguments=("-r", "__node:=destroyed"))
        nodes.peer.spin_until(lambda: "/destroyed/transition_event" in topics(nodes.peer), 30.0, "the node's topics")
        nodes.remove(node)
        nodes.peer.spin_until(
            lambda: not [topic for topic in topics(nodes.peer) if "destroyed" in topic], 30.0, "the end of its topics"
        )
