"""A bad network, a flood of goals, and a second controller."""

import itertools
import math
import re
import sys
import time

import bad_network
import goal_flood
import graph
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from robot import DEEP, distance
from witness import FAR, NEAR

RELAYED = ("odom:relayed/odom:nav_msgs/Odometry", "global_pose:relayed/fix:geometry_msgs/PoseWithCovarianceStamped")
LATE = {"command_latency": bad_network.DELAY + bad_network.JITTER / 2}
GOAL_TIMEOUT = 120.0
FLOOD_RATE = 1000.0


def test_goals_are_reached_over_a_bad_network(observed, trials, seeded):
    arguments = {"ekf": ("-r", "odom:=relayed/odom", "-r", "global_pose:=relayed/fix")}
    with (
        graph.process(sys.executable, bad_network.__file__, "1", *RELAYED) as relay,
        observed(NEAR, controller=LATE, arguments=arguments) as witness,
        trials("network") as running,
    ):
        relay.wait_for_output("ready")
        robot, place = witness.robot, (-4.0, 0.2)
        for _ in running:
            angle = seeded.uniform(-math.pi, math.pi)
            place = (place[0] + math.cos(angle), place[1] + math.sin(angle))
            # The status names few digits.
            goal = tuple(round(number, 2) for number in (*place, seeded.uniform(-math.pi, math.pi)))
            robot.send_goal(*goal, tries=5)
            robot.wait_for_state("goal reached", GOAL_TIMEOUT)
            running.add(kept=distance(robot.true_pose(), goal) <= 0.4)
        assert "Traceback" not in relay.output


class Periods:
    """Times between commands, by the controller's own time of sending."""

    def __init__(self, peer):
        self._sent = []
        peer.node.create_subscription(
            Twist, "cmd_vel", lambda _, info: self._sent.append(info["source_timestamp"]), DEEP
        )

    def p99(self, peer, seconds):
        """Return the 99th percentile [s] of the next ``seconds``."""
        begin = len(self._sent)
        peer.spin_for(seconds)
        gaps = sorted((after - before) * 1e-9 for before, after in itertools.pairwise(self._sent[begin:]))
        assert len(gaps) >= 8 * seconds, "the robot drives"
        return gaps[math.ceil(0.99 * len(gaps)) - 1]


def test_flood_of_goals_leaves_the_control_period(observed, trials, pytestconfig):
    seconds = 20.0 if pytestconfig.getoption("--faults") == "full" else 3.0
    with observed(NEAR) as witness, trials("flood") as running:
        periods = Periods(witness.peer)
        for _ in running:
            witness.drive()
            since = time.monotonic()
            quiet = periods.p99(witness.peer, seconds)
            quiet_delay = running.delay(since)
            command = (sys.executable, goal_flood.__file__, str(FLOOD_RATE), str(seconds + 1.0), str(FAR[0]))
            with graph.process(*command) as flood:
                flood.wait_for_output("ready")
                since = time.monotonic()
                loaded = periods.p99(witness.peer, seconds)
                # The scheduler may have held the quiet phase up, too, but never lowered its figure.
                excess = max(running.delay(since) - quiet_delay, 0.0)
                flood.wait_for_output("sent", 30.0)
                flood.wait()
                sent = int(re.search(r"sent (\d+)", flood.output)[1])
            running.add(loaded / quiet, excess / quiet, kept=sent >= 0.9 * FLOOD_RATE * seconds)


def test_second_controller_on_cmd_vel_is_an_error_that_names_it(observed, trials):
    arguments = ("-r", "__node:=second_controller")
    with observed(NEAR) as witness, trials("two controllers") as running:
        witness.drive()
        for _ in running:
            with graph.node(graph.MODULES["controller"], {}, arguments) as second:
                second.wait_for_output("ready")
                since = time.monotonic()
                report = witness.report_with("/cmd_vel", "second_controller", level=DiagnosticStatus.ERROR)
                assert report.name.endswith("/controller")
                running.measure(time.monotonic() - since, since)
                assert second.stop() == 0
