"""A bad network, a flood of goals, and a second controller."""

import itertools
import math
import re
import statistics
import sys

import bad_network
import goal_flood
import graph
from geometry_msgs.msg import Twist
from robot import DEEP, ON_TRUTH, TRUE_POSES, distance
from witness import FAR, NEAR

RELAYED = ("odom:relayed/odom:nav_msgs/Odometry", "global_pose:relayed/fix:geometry_msgs/PoseWithCovarianceStamped")
LATE = {"command_latency": bad_network.DELAY + bad_network.JITTER / 2}
GOAL_TIMEOUT = 120.0
FLOOD_RATE = 1000.0


def test_goals_are_reached_over_a_bad_network(observed, trials, seeded):
    options = {"only": ("robot", "plant"), "joined": True}
    options["arguments"] = ("-r", "ekf:odom:=relayed/odom", "-r", "ekf:global_pose:=relayed/fix")
    with (
        graph.process(sys.executable, bad_network.__file__, "1", *RELAYED) as relay,
        observed(NEAR, controller=LATE, **options) as witness,
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


def p99(gaps):
    """Return the 99th percentile [s]."""
    return sorted(gaps)[math.ceil(0.99 * len(gaps)) - 1]


def control_periods(sent, output, kind):
    """Return the gaps [s] between commands that were sent at ``sent`` [ns] that lie in one kind of interval."""
    intervals = [tuple(map(int, words)) for words in re.findall(rf"{kind} (\d+) (\d+)", output)]
    return [
        (after - before) * 1e-9
        for before, after in itertools.pairwise(sent)
        if any(begin <= before and after <= end for begin, end in intervals)
    ]


def test_flood_of_goals_leaves_the_control_period(observed, trials, pytestconfig):
    """Floods and pauses alternate, so that what else the machine does meets both alike."""
    full = pytestconfig.getoption("--faults") == "full"
    seconds, times = (5.0, 3) if full else (1.0, 2)
    command = (sys.executable, goal_flood.__file__, *map(str, (FLOOD_RATE, seconds, times, FAR[0])))
    options = {"only": ("controller", "plant"), "arguments": {"controller": TRUE_POSES}}
    with observed(NEAR, controller=ON_TRUTH, **options) as witness, trials("flood") as running:
        sent = []
        witness.peer.node.create_subscription(
            Twist, "cmd_vel", lambda _, info: sent.append(info["source_timestamp"]), DEEP
        )
        for _ in running:
            witness.drive()
            with graph.process(*command) as flood:
                witness.peer.spin_until(
                    lambda process=flood: process.popen.poll() is not None, 120.0, "the flood's end"
                )
                quiet, loaded = (control_periods(sent, flood.output, kind) for kind in ("pause", "flood"))
                goals = sum(map(int, re.findall(r"flood \d+ \d+ (\d+)", flood.output)))
            assert min(len(quiet), len(loaded)) >= (5 * seconds * times if full else 3), "the robot drives"
            # Of few periods the 99th percentile is the largest one, which a single delay by the scheduler decides.
            typical = p99 if full else statistics.median
            running.add(typical(loaded) / typical(quiet), kept=goals >= 0.9 * FLOOD_RATE * seconds * times)
