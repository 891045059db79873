"""What happens to a driving robot when a node is killed, started again, or ended by signals."""

import signal
import time

import graph
import pytest
from robot import distance, robot, stamp, turned, twist

NEAR = {"initial_pose.x": -4.0, "initial_pose.y": 0.2, "initial_pose.yaw": 0.0}


def is_driving(robot):
    return robot.commands and abs(twist(robot.commands[-1])[0]) > 0.3


def zero_since(robot, began):
    """Seconds after ``began`` until the newest command was zero."""
    robot.peer.spin_until(lambda: twist(robot.commands[-1]) == (0.0, 0.0), 5.0, "a zero command")
    return time.monotonic() - began


def true_speed(robot):
    robot.peer.spin_until(lambda: robot.truths, 5.0, "a true pose")
    return abs(robot.truths[-1].twist.twist.linear.x)


@pytest.fixture(scope="module")
def walking():
    with robot(NEAR, controller={"pose_timeout": 0.4}) as running:
        yield running


def test_a_dead_filter_stops_the_robot_and_a_new_one_lets_it_drive_on(walking):
    goal = (0.0, 0.0, 0.0)
    walking.send_goal(*goal)
    walking.peer.spin_until(lambda: is_driving(walking), 5.0, "motion")
    walking.processes["ekf"].send(signal.SIGKILL)
    began = time.monotonic()
    assert 0.2 < zero_since(walking, began) < 5.0, "pose_timeout is 0.4 s; test/faults measures it"
    walking.wait_for_state("stale pose", 2.0)
    walking.peer.spin_until(lambda: true_speed(walking) == 0.0, 2.0, "standstill")
    # The stop is said again and again.
    count = len(walking.commands)
    walking.peer.spin_until(lambda: len(walking.commands) >= count + 5, 3.0, "more zeros")
    assert {twist(command) for command in walking.commands[count:]} == {(0.0, 0.0)}
    assert distance(walking.true_pose(), goal) > 0.5, "the way is still to go"
    walking.start("ekf")
    walking.wait_for_state("goal reached", 90.0)
    walking.peer.spin_for(0.5)
    assert distance(walking.true_pose(), goal) <= 0.4
    assert turned(walking.true_pose(), goal) <= 0.1


def test_a_dead_controller_lets_the_plant_stop_and_a_new_one_waits_for_a_goal(walking):
    walking.send_goal(-4.0, 0.0, 0.0)
    walking.peer.spin_until(lambda: is_driving(walking), 5.0, "motion")
    walking.processes["controller"].send(signal.SIGKILL)
    walking.processes["controller"].wait()
    last = len(walking.commands)
    killed = stamp(walking.truths[-1])
    walking.peer.spin_until(lambda: true_speed(walking) == 0.0, 3.0, "standstill")
    stopped = next(
        stamp(truth) for truth in walking.truths if stamp(truth) > killed and truth.twist.twist.linear.x == 0
    )
    assert 0.2e9 <= stopped - killed <= 5e9, "cmd_vel_timeout is 0.5 s; test/faults measures it"
    place = walking.true_pose()
    walking.start("controller")
    walking.wait_for_state("idle", 3.0)
    walking.peer.spin_for(0.5)
    assert len(walking.commands) - last <= 1, "what was on its way when it died"
    assert walking.true_pose() == place
    walking.send_goal(-3.0, 0.0, 0.0)
    walking.peer.spin_until(lambda: true_speed(walking) > 0.1, 5.0, "motion")


def test_a_slow_filter_stops_the_robot_only_while_it_is_silent(walking):
    walking.send_goal(8.0, 0.0, 0.0)
    walking.peer.spin_until(lambda: is_driving(walking), 5.0, "motion")
    walking.processes["ekf"].send(signal.SIGSTOP)
    try:
        walking.wait_for_state("stale pose", 3.0)
    finally:
        walking.processes["ekf"].send(signal.SIGCONT)
    walking.wait_for_state("driving", 3.0)
    walking.peer.spin_until(lambda: is_driving(walking), 3.0, "motion")
    walking.cancel()


SIGNALS = {
    "SIGINT": [signal.SIGINT],
    "SIGTERM": [signal.SIGTERM],
    "SIGINT again and again": [signal.SIGINT] * 8,
    "SIGINT, then SIGTERM": [signal.SIGINT, signal.SIGTERM],
}


@pytest.mark.parametrize("numbers", SIGNALS.values(), ids=SIGNALS)
def test_signals_end_every_node_with_status_0_and_a_zero_command(numbers, request):
    namespace = f"/signals_{list(SIGNALS).index(request.node.callspec.id)}"
    with robot(NEAR, namespace=namespace) as one:
        one.send_goal(5.0, 0.0, 0.0)
        one.peer.spin_until(lambda: is_driving(one), 5.0, "motion")
        running = list(one.processes.values())
        for number in numbers:
            for process in running:
                if process.popen.poll() is None:
                    process.send(number)
            one.peer.spin_for(0.02)
        statuses = {name: process.wait(5.0) for name, process in one.processes.items()}
        one.peer.spin_for(0.5)
        output = "".join(process.output for process in running)
        assert statuses == {"ekf": 0, "controller": 0, "plant": 0}, output
        assert twist(one.commands[-1]) == (0.0, 0.0), f"{len(one.commands)} commands"
        assert "Traceback" not in output
        assert "rror" not in output


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_a_node_that_has_nothing_to_do(number):
    with graph.node(graph.MODULES["controller"], arguments=("-r", "__ns:=/idle")) as process:
        process.wait_for_output("ready")
        assert process.stop(number, 5.0) == 0
        assert "Traceback" not in process.output
