"""Managed nodes: the requests of Nav2's lifecycle manager, and what the robot does meanwhile."""

from functools import partial

import graph
import one_process
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetState
from nav_msgs.msg import Odometry
from robot import DEEP, initialpose, pose_stamped, stamp, twist

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_control.robot_node import RobotControllerNode
from diffbot_control.ros.messages.fields import set_stamp

# Transition and the state in which Nav2's manager then has to find the node, as its startup, pause, resume, reset and
# shutdown ask for them.
CONFIGURE = (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE)
ACTIVATE = (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE)
DEACTIVATE = (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE)
CLEAN_UP = (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED)
SHUT_DOWN = (Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, State.PRIMARY_STATE_FINALIZED)
NODES = ("ekf", "controller")


class Manager:
    """Asks as nav2_lifecycle_manager does: change the state, then look whether it is the expected one."""

    def __init__(self, peer, process):
        self.peer, self.process = peer, process

    def request(self, name, transition=0, label=""):
        """Return whether the node reports success."""
        request = ChangeState.Request(transition=Transition(id=transition, label=label))
        return self.peer.call(ChangeState, f"{name}/change_state", request).success

    def state(self, name):
        return self.peer.call(GetState, f"{name}/get_state").current_state.id

    def change(self, name, transition, expected):
        assert self.request(name, transition)
        assert self.state(name) == expected


@pytest.fixture(scope="module")
def robot():
    """Run filter and controller in one process, both waiting for a manager."""
    parameters = {"autostart": False, "reliable_inputs": True}
    with graph.peer() as peer, graph.node(graph.MODULES["robot"], parameters) as process:
        process.wait_for_output("[controller]: ready")
        yield Manager(peer, process)


def topics(peer):
    return {name for name, _ in peer.node.get_topic_names_and_types()}


def test_pause_resume_and_reset_by_a_manager(robot):
    peer = robot.peer
    events = {name: peer.subscribe(TransitionEvent, f"{name}/transition_event") for name in NODES}
    commands = peer.subscribe(Twist, "cmd_vel")
    peer.wait_for_publishers(*(f"{name}/transition_event" for name in NODES))
    assert "/pose" not in topics(peer)
    for step in (CONFIGURE, ACTIVATE, DEACTIVATE, ACTIVATE, DEACTIVATE, CLEAN_UP, CONFIGURE):
        # Startup in the order of the manager's list, everything else in the reverse order.
        for name in NODES if step in (CONFIGURE, ACTIVATE) else NODES[::-1]:
            robot.change(name, *step)
        if step is ACTIVATE:
            assert {"/pose", "/odometry/filtered", "/odom", "/goal_pose"} <= topics(peer)
            peer.wait_for_publishers("cmd_vel")
    for name in NODES:
        peer.spin_until(lambda name=name: len(events[name]) >= 14, what="two events of each transition")
        assert [event.goal_state.label for event in events[name]][:4] == [
            "configuring", "inactive", "activating", "active",
        ]  # fmt: skip
    peer.spin_until(lambda: len(commands) >= 2, what="a stop command of each deactivation")
    assert {twist(command) for command in commands} == {(0.0, 0.0)}


class Sensors:
    """Odometry and goals of the test."""

    def __init__(self, peer):
        self.peer = peer
        self.commands = peer.subscribe(Twist, "cmd_vel", DEEP)
        self.poses = peer.subscribe(PoseWithCovarianceStamped, "pose", DEEP)
        self.odometries, self.goals = peer.publisher(Odometry, "odom"), peer.publisher(PoseStamped, "goal_pose")
        self.starts = peer.publisher(PoseWithCovarianceStamped, "initialpose")
        peer.wait_for_subscribers(self.odometries, self.goals, self.starts)

    def step(self):
        """Send an odometry of now; return its stamp."""
        message = Odometry(child_frame_id="base_link")
        message.pose.pose.orientation.w = 1.0
        message.twist.covariance[[0, 35]] = 1e-3
        set_stamp(message.header.stamp, self.peer.node.get_clock().now().nanoseconds)
        self.odometries.publish(message)
        self.peer.spin_for(0.02)
        return stamp(message)

    def until_answered(self):
        """Send odometry until a pose answers one that was sent after this call."""
        first = self.step()
        self.peer.spin_until(lambda: self.step() and self.poses and stamp(self.poses[-1]) >= first, what="a pose")

    def drive(self):
        """Send goals and odometry until a command to move comes."""
        self.commands.clear()

        def moving():
            self.goals.publish(pose_stamped(5.0, 0.0, 0.0))
            self.step()
            return any(one.linear.x > 0.0 for one in self.commands)

        self.peer.spin_until(moving, what="a command to drive")

    def wait_for_stop(self):
        self.peer.spin_until(lambda: self.commands and twist(self.commands[-1]) == (0.0, 0.0), what="the stop")


def test_a_deactivated_controller_stops_the_robot_and_starts_idle_again(robot):
    sensors = Sensors(robot.peer)
    for name in NODES:
        robot.change(name, *ACTIVATE)
    sensors.starts.publish(initialpose(0.0, 0.0, 0.0))
    sensors.drive()
    robot.change("controller", *DEACTIVATE)
    sensors.wait_for_stop()
    before = len(sensors.commands)
    sensors.goals.publish(pose_stamped(5.0, 0.0, 0.0))
    sensors.until_answered()  # the filter goes on
    robot.change("controller", *ACTIVATE)
    sensors.until_answered()
    sensors.until_answered()
    assert len(sensors.commands) == before  # neither the old goal nor the one it got while inactive
    sensors.drive()
    robot.change("ekf", *DEACTIVATE)
    # Without poses the controller stops the robot by itself.
    sensors.peer.spin_until(lambda: sensors.step() and twist(sensors.commands[-1]) == (0.0, 0.0), what="the stop")


def test_a_transition_that_the_state_does_not_have_is_refused_and_the_node_lives(robot):
    active = robot.state("controller")
    assert active == State.PRIMARY_STATE_ACTIVE
    for transition, label in ((Transition.TRANSITION_CONFIGURE, ""), (99, ""), (0, "fly"), (0, "configure")):
        assert not robot.request("controller", transition, label)
    assert robot.state("controller") == active
    assert "no transition fly from active: refused" in robot.process.output
    states = robot.peer.call(GetAvailableStates, "controller/get_available_states").available_states
    assert {"unconfigured", "inactive", "active", "finalized"} <= {state.label for state in states}


def test_shutdown_from_active_stops_the_robot_and_the_process_ends_by_its_signal(robot):
    commands = robot.peer.subscribe(Twist, "cmd_vel")
    robot.peer.wait_for_publishers("cmd_vel")
    commands.clear()
    robot.change("controller", Transition.TRANSITION_ACTIVE_SHUTDOWN, State.PRIMARY_STATE_FINALIZED)
    robot.peer.spin_until(lambda: commands and twist(commands[-1]) == (0.0, 0.0), what="the stop")
    robot.change("ekf", *CLEAN_UP)
    robot.change("ekf", *SHUT_DOWN)
    assert robot.process.stop() == 0
    assert "Traceback" not in robot.process.output


def test_a_node_that_cannot_be_configured_stays_unconfigured_and_reports_why(capfd):
    with one_process.nodes() as nodes:
        ekf = nodes.add(EkfNode)
        nodes.add(partial(RobotControllerNode, ekf), {"autostart": False, "map_frame": "world"})
        manager = Manager(nodes.peer, None)
        assert not manager.request("controller", Transition.TRANSITION_CONFIGURE)
        assert manager.state("controller") == State.PRIMARY_STATE_UNCONFIGURED
        text = "map_frame: the controller has 'world', the ekf 'map': must be the same"
        assert text in "".join(capfd.readouterr())
        node = nodes.peer.node
        nodes.peer.spin_until(lambda: not node.get_publishers_info_by_topic("/cmd_vel"), what="no publisher")


@pytest.mark.parametrize("kind", [ControllerNode, EkfNode])
def test_a_timer_that_is_due_while_the_node_is_cleaned_up_does_nothing(kind):
    """The executor takes it in one go with the request, and calls it after its publishers are destroyed."""
    with one_process.nodes() as nodes:
        node = nodes.add(kind)
        due = [timer.callback for timer in node.timers]
        assert due
        node.trigger_deactivate()
        node.trigger_cleanup()
        for callback in due:
            callback()
        assert node.faults.newest == ""
