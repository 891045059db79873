"""Managed nodes: the requests of Nav2's lifecycle manager, and the behaviour of the robot during them."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from filter_input import fix, odometry
from geometry_msgs.msg import PoseStamped, Twist
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetState
from robot import DEEP, pose_stamped, twist

from diffbot_control import controller_node
from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_control.robot_node import RobotControllerNode
from diffbot_control.ros.navigator import Navigator
from diffbot_core.errors import DiffbotError
from diffbot_core.ros.managed_node import ManagedNode
from diffbot_core.ros.run import run
from diffbot_core.shared_parameters import LifecycleConfig

# The transitions of startup, pause, resume, reset and shutdown by Nav2's manager, and the state that it then expects.
CONFIGURE = (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE)
ACTIVATE = (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE)
DEACTIVATE = (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE)
CLEAN_UP = (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED)
SHUT_DOWN = (Transition.TRANSITION_ACTIVE_SHUTDOWN, State.PRIMARY_STATE_FINALIZED)
NODES = ("ekf", "controller")


class Manager:
    """Requests transitions as nav2_lifecycle_manager does, and checks the state after each transition."""

    def __init__(self, nodes, controller=None):
        """Create filter and controller, which wait for a manager; the test is their sensors."""
        self.peer, self.time = nodes.peer, 1000.0
        self.fed = one_process.Fed(nodes, EkfNode, {"autostart": False, "reliable_inputs": True})
        parameters = {"autostart": False, "pose_timeout": 60.0, **(controller or {})}
        self.controller = nodes.add(partial(RobotControllerNode, self.fed.node), parameters)
        self.commands = self.peer.subscribe(Twist, "cmd_vel", DEEP)
        self.goals = self.peer.publisher(PoseStamped, "goal_pose")

    def request(self, name, transition=0, label=""):
        request = ChangeState.Request(transition=Transition(id=transition, label=label))
        return self.peer.call(ChangeState, f"{name}/change_state", request).success

    def state(self, name):
        return self.peer.call(GetState, f"{name}/get_state").current_state.id

    def change(self, name, transition, expected):
        assert self.request(name, transition)
        assert self.state(name) == expected

    def move(self):
        """Send odometry, and with it a pose to the controller."""
        self.time += 0.1
        self.fed.send("odom", odometry(self.time))

    def drive(self):
        """Send goals and odometry until a command moves the robot."""
        self.commands.clear()
        if not self.fed.node.health.accepted["global_pose"]:
            self.fed.send("global_pose", fix(self.time))

        def moving():
            self.goals.publish(pose_stamped(9.0, 0.0, 0.0))
            self.move()
            return any(one.linear.x > 0.0 for one in self.commands)

        self.peer.spin_until(moving, what="a command to drive")

    def wait_for_stop(self):
        self.peer.spin_until(lambda: self.commands and twist(self.commands[-1]) == (0.0, 0.0), what="the stop")


def topics(peer):
    return {name for name, _ in peer.node.get_topic_names_and_types()}


def test_a_manager_starts_pauses_resumes_and_resets_both_nodes(nodes):
    manager, peer = Manager(nodes), nodes.peer
    events = {name: peer.subscribe(TransitionEvent, f"{name}/transition_event") for name in NODES}
    peer.wait_for_publishers(*(f"{name}/transition_event" for name in NODES))
    assert "/pose" not in topics(peer)
    for step in (CONFIGURE, ACTIVATE, DEACTIVATE, ACTIVATE, DEACTIVATE, CLEAN_UP, CONFIGURE):
        # Startup in the order of the manager's list, everything else in the reverse order.
        for name in NODES if step in (CONFIGURE, ACTIVATE) else NODES[::-1]:
            manager.change(name, *step)
        if step is ACTIVATE:
            assert {"/pose", "/odometry/filtered", "/odom", "/goal_pose"} <= topics(peer)
    for name in NODES:
        peer.spin_until(lambda name=name: len(events[name]) >= 14, what="two events of each transition")
        assert [event.goal_state.label for event in events[name]][:4] == [
            "configuring", "inactive", "activating", "active",
        ]  # fmt: skip


def test_a_deactivated_controller_stops_cancels_its_goal_and_is_idle_after_the_next_activation(nodes, capfd):
    manager = Manager(nodes)
    for name in NODES:
        manager.change(name, *CONFIGURE)
        manager.change(name, *ACTIVATE)
    manager.drive()
    manager.change("controller", *DEACTIVATE)
    manager.wait_for_stop()
    ended = manager.controller.supervisor.goals.ended
    assert ended[-1].text == "cancelled: by the deactivation of the controller"
    before = len(manager.commands)
    for _ in range(20):  # as by a planner that goes on
        manager.goals.publish(pose_stamped(5.0, 0.0, 0.0))
        manager.move()  # the filter is still active
    manager.change("controller", *ACTIVATE)
    manager.move()
    manager.move()
    assert len(manager.commands) == before, "the goals of before are not driven to"
    manager.drive()
    for transition, label in ((Transition.TRANSITION_CONFIGURE, ""), (99, ""), (0, "fly"), (0, "configure")):
        assert not manager.request("controller", transition, label)
    assert manager.state("controller") == State.PRIMARY_STATE_ACTIVE
    assert "transition fly refused: it is not possible in the state active" in capfd.readouterr().err
    states = nodes.peer.call(GetAvailableStates, "controller/get_available_states").available_states
    assert {"unconfigured", "inactive", "active", "finalized"} <= {state.label for state in states}
    manager.commands.clear()
    manager.change("controller", *SHUT_DOWN)
    manager.wait_for_stop()


def test_the_navigator_starts_both_nodes_and_shuts_them_down(nodes):
    manager, navigator = Manager(nodes), Navigator.in_own_context()
    with ThreadPoolExecutor(1) as pool:
        for call, state in (
            (navigator.lifecycleStartup, State.PRIMARY_STATE_ACTIVE),
            (navigator.lifecycleStartup, State.PRIMARY_STATE_ACTIVE),
            (navigator.lifecycleShutdown, State.PRIMARY_STATE_FINALIZED),
        ):
            answer = pool.submit(call)
            nodes.peer.spin_until(answer.done, what=call.__name__)
            assert answer.result()
            assert [manager.state(name) for name in NODES] == [state, state]
        answer = pool.submit(navigator.lifecycleStartup)
        nodes.peer.spin_until(answer.done, what="the answer")
        assert not answer.result(), "for good"
    navigator.close()


def test_a_node_that_cannot_be_configured_stays_unconfigured_and_reports_why(nodes, capfd, monkeypatch):
    served = []
    monkeypatch.setattr(controller_node, "serve", lambda *_: served.append("action"))
    manager = Manager(nodes, {"map_frame": "world"})
    manager.change("ekf", *CONFIGURE)
    assert not manager.request("controller", Transition.TRANSITION_CONFIGURE)
    assert manager.state("controller") == State.PRIMARY_STATE_UNCONFIGURED
    text = "map_frame is 'world' in the controller, but 'map' in the ekf: set both to the same frame"
    assert text in "".join(capfd.readouterr())
    node = nodes.peer.node
    nodes.peer.spin_until(lambda: not node.get_publishers_info_by_topic("/cmd_vel"), what="no publisher")
    assert not served


@pytest.mark.parametrize("kind", [ControllerNode, EkfNode])
def test_a_timer_that_is_due_while_the_node_is_cleaned_up_does_nothing(nodes, kind):
    """The executor collects it together with the request, and calls it after its publishers are destroyed."""
    node = nodes.add(kind)
    due = [timer.callback for timer in node.timers]
    assert due
    node.trigger_deactivate()
    node.trigger_cleanup()
    for callback in due:
        callback()
    assert node.faults.newest == ""


class Failing(ManagedNode):
    """A node whose steps raise the errors in ``raises`` once."""

    def __init__(self, raises=None, **options):
        self.raises = raises or {}
        super().__init__("failing", LifecycleConfig, **options)

    def configure(self):
        self.create_publisher(PoseStamped, "configured", 1)
        self._step("configure")

    def activate(self):
        self._step("activate")

    def deactivate(self):
        self._step("deactivate")

    def cleanup(self):
        self._step("cleanup")

    def _step(self, name):
        if error := self.raises.pop(name, None):
            raise error


UNFORESEEN, REFUSED = ValueError("broken sensor"), DiffbotError("no sensor")


@pytest.mark.parametrize(("step", "error"), [("configure", UNFORESEEN), ("activate", REFUSED)])
def test_a_node_that_cannot_start_itself_ends_with_its_error(step, error, kept_signal_handlers, capfd):
    assert run(partial(Failing, {step: error}), []) == 1
    output = "".join(capfd.readouterr())
    text = "ValueError: broken sensor" if error is UNFORESEEN else "no sensor"
    assert f"error: /failing: {text}\n" in output
    assert f"{step}: {text}" in output
    assert ("Traceback" in output) == (error is UNFORESEEN)
    assert "ready" not in output


def test_a_transition_that_raises_fails_and_is_reported_until_one_succeeds(nodes, capfd):
    node, peer = nodes.add(Failing, {"autostart": False}), nodes.peer
    ok, fault = DiagnosticStatus.OK[0], DiagnosticStatus.ERROR[0]

    def request(transition):
        change = ChangeState.Request(transition=Transition(label=transition))
        return peer.call(ChangeState, "failing/change_state", change).success

    for step, error, state in (
        ("activate", REFUSED, "inactive"),
        # A node that has stopped a part of its work is neither active nor inactive.
        ("deactivate", REFUSED, "unconfigured"),
        ("configure", UNFORESEEN, "unconfigured"),
    ):
        # The node can be used again after each failure.
        for transition in {"activate": ("configure",), "deactivate": ("activate",)}.get(step, ()):
            assert request(transition)
            assert node.diagnosis()[0] == ok
        node.raises[step] = error
        assert not request(step)
        assert peer.call(GetState, "failing/get_state").current_state.label == state
        assert bool(peer.node.get_publishers_info_by_topic("/configured")) == (state == "inactive")
        level, text, _ = node.diagnosis()
        assert level == fault
        assert text.startswith(f"{state}; ")
        assert str(error) in text
        assert f"{step}: " in capfd.readouterr().err
    assert request("configure")
    assert request("activate")
    # An unforeseen error is a defect of the node and stays in the report, as any internal error does.
    assert node.diagnosis()[0] == fault


def test_an_exception_while_deactivating_stops_the_robot(nodes):
    manager = Manager(nodes)
    for name in NODES:
        manager.change(name, *CONFIGURE)
        manager.change(name, *ACTIVATE)
    manager.drive()
    manager.controller.supervisor.on_stop = None  # raises TypeError when it is called
    assert not manager.request("controller", Transition.TRANSITION_DEACTIVATE)
    assert manager.state("controller") == State.PRIMARY_STATE_UNCONFIGURED
    manager.wait_for_stop()
