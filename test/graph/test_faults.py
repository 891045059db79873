"""Malformed calls and times, and callbacks that raise: nodes work on, and an internal error stops the robot."""

from functools import partial
from types import SimpleNamespace

import graph
import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from robot import initialpose, pose_stamped
from rosgraph_msgs.msg import Clock

from diffbot_control.controller_node import ControllerNode
from diffbot_control.law.supervisor import Supervisor
from diffbot_core.ros import node as node_module
from diffbot_core.ros.node import make_executor

NOT_A_TYPE = 10


@pytest.fixture(params=["events", "single"])
def simulated(request):
    """Have a filter, a controller and a plant that follow the test's /clock."""
    environment = graph.environment(DIFFBOT_EXECUTOR=request.param)
    plant = {"use_sim_time": True, "clock": "scaled", "publish_clock": False}
    with (
        graph.peer() as peer,
        graph.node(graph.MODULES["robot"], {"use_sim_time": True}, env=environment) as robot,
        graph.node(graph.MODULES["plant"], plant, env=environment) as plant,
    ):
        robot.wait_for_output("[controller]: ready")
        plant.wait_for_output("ready")
        yield peer, (robot, plant)


def reports(peer, found, nodes, condition, send=lambda: None):
    """Call ``send`` again and again, until a new report of each node meets the condition."""
    begin = len(found)

    def met():
        send()
        news = {status.name.strip("/"): graph.values(status) for one in found[begin:] for status in one.status}
        return all(name in news and condition(news[name]) for name in nodes)

    peer.spin_until(met, 10.0, f"reports of {nodes}")


def test_malformed_calls_and_times_are_refused_counted_and_harmless(simulated):
    peer, processes = simulated
    names = ("ekf", "controller", "plant")
    found = peer.subscribe(DiagnosticArray, "/diagnostics", 100)
    bad = Parameter(name="wheel_radius", value=ParameterValue(type=NOT_A_TYPE))
    good = Parameter(name="use_sim_time", value=ParameterValue(type=1, bool_value=True))
    for name in names:
        request = SetParameters.Request(parameters=[good, bad, good])
        results = peer.call(SetParameters, f"{name}/set_parameters", request).results
        assert [result.successful for result in results] == [True, False, False]
        assert "10 is not a valid Parameter.Type" in results[1].reason
        request = SetParametersAtomically.Request(parameters=[bad])
        result = peer.call(SetParametersAtomically, f"{name}/set_parameters_atomically", request).result
        assert not result.successful
        assert "10 is not a valid Parameter.Type" in result.reason
    clocks = peer.publisher(Clock, "/clock")
    peer.wait_for_subscribers(clocks, count=3)
    message = Clock()
    message.clock.sec = -1
    # Repeated: best effort, and a subscriber that the publisher knows may not know the publisher yet.
    send = partial(clocks.publish, message)
    reports(peer, found, names, lambda values: any("/clock dropped" in key for key in values), send)
    reports(peer, found, names, lambda values: any("set_parameters dropped" in key for key in values))
    for process in processes:
        assert process.popen.poll() is None
        assert "Traceback" not in process.output
        assert process.stop() == 0


@pytest.fixture
def nodes():
    with one_process.nodes() as running:
        yield running


def drive(nodes, **parameters):
    """Return a controller that drives by poses of the test, what publishes them, and the commands."""
    node = nodes.add(ControllerNode, parameters)
    peer = nodes.peer
    commands = peer.subscribe(Twist, "cmd_vel")
    goals, poses = peer.publisher(PoseStamped, "goal_pose"), peer.publisher(PoseWithCovarianceStamped, "pose")
    peer.wait_for_subscribers(goals, poses)
    peer.wait_for_publishers("cmd_vel")

    def go():
        goals.publish(pose_stamped(5.0, 0.0, 0.0))
        peer.spin_until(lambda: node.supervisor.goal is not None, 5.0, "the goal")
        step()
        peer.spin_until(lambda: commands and commands[-1].linear.x > 0.0, 5.0, "motion")

    def step():
        message = initialpose(0.0, 0.0, 0.0)
        step.stamp += 1
        message.header.stamp.sec = step.stamp
        poses.publish(message)

    step.stamp = 1000
    return node, go, step, commands


def broken(*_arguments):
    raise RuntimeError("broken law")


def test_unforeseen_error_stops_the_robot_is_reported_once_and_the_next_goal_is_driven_to(nodes, monkeypatch, capfd):
    node, go, step, commands = drive(nodes)
    found = nodes.peer.subscribe(DiagnosticArray, "/diagnostics", 100)
    go()
    with monkeypatch.context() as patch:
        patch.setattr(Supervisor, "on_pose", broken)
        for count in (1, 2):
            step()
            nodes.peer.spin_until(lambda count=count: node.health.counted["internal errors"] == count, 5.0, "the error")
    nodes.peer.spin_until(lambda: commands[-1] == Twist(), 5.0, "the stop")
    assert node.supervisor.goal is None
    text = "internal error in pose: RuntimeError: broken law"
    statuses = nodes.peer.spin_until(
        lambda: [one for array in found for one in array.status if text in one.message], 5.0, "the report"
    )
    assert statuses[0].level == DiagnosticStatus.ERROR
    assert 'raise RuntimeError("broken law")' in graph.values(statuses[0])["traceback"]
    log = capfd.readouterr().err
    assert log.count(f"{text} (logged once)") == 1
    record = node.supervisor.goals.ended[-1]
    assert (record.end, record.reason) == ("not reached", text)
    assert log.count("Traceback") == 1
    commands.clear()
    go()
    assert node.exit_code is None


def test_unforeseen_error_ends_the_node_with_status_1_where_that_is_asked_for(nodes, monkeypatch):
    node, go, step, commands = drive(nodes, exit_on_error=True)
    go()
    monkeypatch.setattr(Supervisor, "on_pose", broken)
    step()
    nodes.peer.spin_until(lambda: node.exit_code == 1, 5.0, "the end")
    nodes.peer.spin_until(lambda: commands[-1] == Twist(), 5.0, "the stop")


def test_error_of_a_timer_leaves_the_other_timers_running(nodes, monkeypatch):
    node, go, _, commands = drive(nodes)
    go()
    monkeypatch.setattr(Supervisor, "on_tick", broken)
    nodes.peer.spin_until(lambda: node.health.counted["internal errors"] >= 3, 5.0, "errors")
    nodes.peer.spin_until(lambda: commands[-1] == Twist(), 5.0, "the stop")


def test_error_of_the_executor_itself_leaves_the_node_running(nodes, monkeypatch):
    """After an exception an EventsExecutor handles nothing: the next one does."""
    made = []

    class Failing:
        def spin_once(self, timeout_sec):
            raise RuntimeError("no take")

        def shutdown(self):
            made.append("shut down")

    def executor_of(spun):
        made.append(spun)
        return Failing() if len(made) == 1 else real(spun)

    real = node_module._executor_of
    monkeypatch.setattr(node_module, "_executor_of", executor_of)
    node = ControllerNode(context=nodes.peer.context)
    node.create_timer(0.01, lambda: node.finish(0), clock=node.steady_clock)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(node_module, "make_executor", lambda: make_executor(nodes.peer.context))
            node_module._spin([node], SimpleNamespace(is_set=False))
        assert made == [[node], "shut down", [node]]
        assert node.exit_code == 0
    finally:
        node.destroy_node()
