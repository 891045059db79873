"""Malformed calls and times are refused, and an internal error stops the robot but not the node."""

from types import SimpleNamespace

import graph
import one_process
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from filter_input import timed
from geometry_msgs.msg import Twist
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from robot import initialpose, pose_stamped
from rosgraph_msgs.msg import Clock

from diffbot_control.controller_node import ControllerNode
from diffbot_control.goals.supervisor import Supervisor
from diffbot_core.ros import run as run_module
from diffbot_core.ros.node import DiffbotNode
from diffbot_core.ros.run import make_executor
from diffbot_core.shared_parameters import FaultConfig

NOT_A_TYPE = 10


class Plain(DiffbotNode):
    def __init__(self, **options):
        super().__init__("plain", FaultConfig, **options)


def test_malformed_calls_and_times_are_refused_and_counted(nodes, capfd):
    peer, node = nodes.peer, nodes.add(Plain, {"use_sim_time": True})
    bad = Parameter(name="exit_on_error", value=ParameterValue(type=NOT_A_TYPE))
    good = Parameter(name="use_sim_time", value=ParameterValue(type=1, bool_value=True))
    request = SetParameters.Request(parameters=[good, bad, good])
    results = peer.call(SetParameters, "plain/set_parameters", request).results
    assert [result.successful for result in results] == [True, False, False]
    assert "10 is not a valid Parameter.Type" in results[1].reason
    request = SetParametersAtomically.Request(parameters=[bad])
    assert not peer.call(SetParametersAtomically, "plain/set_parameters_atomically", request).result.successful
    clocks, message = peer.publisher(Clock, "/clock"), Clock()
    peer.wait_for_subscribers(clocks)
    message.clock.sec = -1

    def counted():
        clocks.publish(message)  # best effort: a message may be lost
        calls = {"plain/set_parameters", "plain/set_parameters_atomically"}
        return {topic for topic, _ in node.health.dropped} == {"/clock", *calls}

    peer.spin_until(counted, what="the drops")
    assert "Traceback" not in "".join(capfd.readouterr())


class Drive(one_process.Fed):
    def __init__(self, nodes, parameters=None):
        super().__init__(nodes, ControllerNode, {"pose_timeout": 60.0, **(parameters or {})})
        self.commands = self.peer.subscribe(Twist, "cmd_vel", 100)
        self.time = 1000.0

    def go(self):
        self.send("goal_pose", pose_stamped(50.0, 0.0, 0.0))
        # On a busy machine, the controller may have stopped the robot in between.
        self.peer.spin_until(lambda: self.step() or self._moves(), what="motion")

    def _moves(self):
        return bool(self.commands) and self.commands[-1].linear.x > 0.0

    def step(self, dt=0.1):
        self.time += dt
        self.send("pose", timed(initialpose(0.0, 0.0, 0.0), self.time))

    def wait_for_stop(self):
        self.peer.spin_until(lambda: self.commands[-1] == Twist(), what="the stop")


def broken(*_arguments):
    raise RuntimeError("broken law")


def test_unforeseen_error_stops_the_robot_is_reported_once_and_the_next_goal_is_driven_to(nodes, monkeypatch, capfd):
    drive = Drive(nodes)
    found = nodes.peer.subscribe(DiagnosticArray, "/diagnostics", 100)
    drive.go()
    with monkeypatch.context() as patch:
        patch.setattr(Supervisor, "on_pose", broken)
        drive.step()
        drive.step()
    assert drive.node.health.counted["internal errors"] == 2
    drive.wait_for_stop()
    assert drive.node.supervisor.goal is None
    text = "internal error in pose: RuntimeError: broken law"
    statuses = nodes.peer.spin_until(
        lambda: [one for array in found for one in array.status if text in one.message], what="the report"
    )
    assert statuses[0].level == DiagnosticStatus.ERROR
    assert 'raise RuntimeError("broken law")' in graph.values(statuses[0])["traceback"]
    log = capfd.readouterr().err
    assert (log.count(f"{text} (logged once)"), log.count("Traceback")) == (1, 1)
    record = drive.node.supervisor.goals.ended[-1]
    assert (record.end, record.reason) == ("not reached", text)
    drive.go()
    assert drive.node.exit_code is None


def test_unforeseen_error_ends_the_node_with_status_1_if_exit_on_error_is_set(nodes, monkeypatch):
    drive = Drive(nodes, {"exit_on_error": True})
    drive.go()
    monkeypatch.setattr(Supervisor, "on_tick", broken)
    counted = drive.node.health.counted
    nodes.peer.spin_until(lambda: counted["internal errors"] >= 3, what="errors of a timer that continues")
    assert drive.node.exit_code == 1
    drive.wait_for_stop()


def test_error_of_the_executor_itself_leaves_the_node_running(nodes, monkeypatch):
    """After an exception an EventsExecutor does not handle anything: it is replaced."""
    made = []

    class Failing:
        def spin_once(self, timeout_sec):
            raise RuntimeError("no take")

        def shutdown(self):
            made.append("shut down")

    def executor_of(spun):
        made.append(spun)
        return Failing() if len(made) == 1 else real(spun)

    real = run_module._executor_of
    monkeypatch.setattr(run_module, "_executor_of", executor_of)
    node = ControllerNode(context=nodes.peer.context)
    node.create_timer(0.01, lambda: node.finish(0), clock=node.steady_clock)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(run_module, "make_executor", lambda: make_executor(nodes.peer.context))
            run_module._spin([node], SimpleNamespace(is_set=False))
        assert made == [[node], "shut down", [node]]
        assert node.exit_code == 0
    finally:
        node.destroy_node()
