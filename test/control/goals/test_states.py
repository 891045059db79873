"""The table of states: required entries, and random hostile histories.

``DIFFBOT_HISTORIES=100000 pytest test/control/goals/test_states.py`` runs as many histories; `make test` runs a few.
"""

import math
import os
import random
from typing import NamedTuple

from diffbot_control.goals import ENDS, STATUS_TEXTS, GoalRequest, State, Supervisor, SupervisorConfig
from diffbot_control.goals.record import REACHED, REFUSED
from diffbot_control.goals.states import WITH_GOAL
from diffbot_control.law import PRESETS, GoalTolerance, Law, PaperLaw, Report, SwitchingLaw
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Uncertainty

HISTORIES = int(os.environ.get("DIFFBOT_HISTORIES", "500"))
STAMP_JITTER = 0.05
"""[s] by which stamps may run ahead of the time that has passed"""
EVENTS = 60
"""number of events of a history before the test waits for the end of the last goal"""
LONG = 5000.0
"""[s] a goal so far away that its time is longer is cancelled"""
TICK = 0.5
"""[s] largest time between two ticks of the node that is not suspended"""
SLOW = PRESETS["tuned"].config._replace(
    tolerance=GoalTolerance(settling_steps=2),
    data_sheet=DataSheet(v_max=0.7, omega_max=1.5, a_max=0.5, omega_dot_max=1.5),
)


class FoolConfig(NamedTuple):
    data_sheet: DataSheet = DataSheet(v_max=0.7, omega_max=1.5, a_max=0.5, omega_dot_max=1.5)
    tolerance: GoalTolerance = GoalTolerance()


class FoolMemory(NamedTuple):
    reached: bool = False


def fool(rng, is_tame):
    """Return a law whose functions raise errors; it returns nonsense, reaches far goals, or turns without end."""

    def step(memory, observation, goal, config):
        v = math.nan if rng.random() < 0.02 else rng.uniform(-9.0, 9.0)
        report = Report(math.dist(observation.estimate.pose[:2], goal[:2]), 0.0, 0.0, 0.0, 0.0, 0, 0.0)
        return FoolMemory(memory.reached or rng.random() < 0.01), Twist(v, rng.uniform(-9.0, 9.0)), report

    def failing(function, share):
        def called(*given):
            if not is_tame[0] and rng.random() < share:
                raise ZeroDivisionError
            return function(*given)

        return staticmethod(called)

    functions = {
        "new_memory": failing(lambda config: FoolMemory(), 0.02),
        "step": failing(step, 0.02),
        "after_command": failing(lambda memory, command, dt, config: memory, 0.005),
        "describe": failing(lambda memory, config: {"mood": 3}, 0.005),
        "reason_to_give_up": failing(lambda memory, config: "bored" if rng.random() < 0.005 else "", 0.005),
    }
    return type("Fool", (Law,), {"name": "fool", "Config": FoolConfig, **functions})


class History:
    """Calls a supervisor as the node does, with random clocks, stamps, poses and covariances."""

    def __init__(self, seed):
        self.rng = rng = random.Random(seed)
        is_tame = [True]
        laws = [(SwitchingLaw, SLOW), (PaperLaw, PRESETS["paper"].config), (fool(rng, is_tame), FoolConfig())]
        law, controller = rng.choice(laws)
        self.config = SupervisorConfig(
            controller=controller,
            pose_lost_timeout=rng.choice([0.0, 2.0, 30.0]),
            goal_timeout=rng.choice([-1.0, -1.0, 3.0, 20.0]),
            waypoint_radius=rng.choice([0.0, 0.5]),
            hold_goal=rng.random() < 0.7,
            publish_when_idle=rng.random() < 0.3,
        )
        self.supervisor = Supervisor(self.config, law)
        is_tame[0] = False
        self.sheet = controller.data_sheet
        self.is_simulated = self.supervisor.clock.is_simulated = rng.random() < 0.3
        self.last, self.last_sent = Twist(0.0, 0.0), -math.inf
        self.steady = rng.uniform(0.0, 1e6)
        self.now = rng.choice([0.0, 1e3, 1.7e9])
        self.stamp = rng.choice([1, 10**9, int(1.7e18)])
        self.truth = Pose(rng.uniform(-5, 5), rng.uniform(-5, 5), rng.uniform(-3, 3))
        self.counted = self.number = 0
        """[s] time since the newest goal on the node's clock; each event counts at least 0 s and at most 1 s"""
        self.taken, self.states = [], set()

    def wait(self):
        """Let time pass with ticks, as in the node; sometimes suspend the node or set its clock."""
        rng = self.rng
        passed = rng.choice([0.02, 0.02, 0.02, 0.1, 0.6, 5.0])
        self.stamp += rng.choice([round(passed * 1e9)] * 12 + [0, 0, 1, -(10**9), 10**12])
        if rng.random() < 0.95:
            while passed > TICK and rng.random() < 0.97:
                self.pass_time(TICK, TICK)
                self.tick()
                passed -= TICK
            self.pass_time(passed, passed)
        else:
            self.pass_time(passed, rng.uniform(-100.0, 300.0))

    def pass_time(self, passed, by_the_clock):
        self.steady += passed
        self.now += by_the_clock
        self.counted += min(max(by_the_clock, 0.0), 1.0)

    def goal(self):
        rng = self.rng
        ahead = [
            Pose(*(rng.gauss(0.0, rng.choice([0.01, 3.0, 300.0])) for _ in "xyz")) for _ in range(rng.randint(1, 3))
        ]
        if rng.random() < 0.3:
            ahead[0] = self.truth
        self.number += 1
        self.counted = 0.0
        request = GoalRequest(str(self.number), "test", self.now)
        if len(ahead) == 1 and rng.random() < 0.8:
            self.supervisor.on_goal(ahead[0], request)
        else:
            self.supervisor.on_path(ahead, request)

    def pose(self):
        rng = self.rng
        if rng.random() < 0.03:
            self.truth = Pose(*(rng.gauss(0.0, rng.choice([0.1, 3.0, 1e9])) for _ in "xyz"))
        sigma = rng.choice([0.0, 0.01, 0.01, 0.03, 1.0, 1e300])
        self.sent(self.supervisor.on_pose(self.stamp, self.now, self.truth, Uncertainty(sigma, sigma), self.steady))

    def sent(self, command):
        if command is None:
            return
        self.check_bounds(command)
        x, y, theta = self.truth
        x, y = x + 0.1 * command.v * math.cos(theta), y + 0.1 * command.v * math.sin(theta)
        self.truth = Pose(x, y, theta + 0.1 * command.omega)

    def check_bounds(self, command):
        """Check the bounds since the last different command; zero may be sent at once."""
        assert all(math.isfinite(one) for one in command)
        assert abs(command.v) <= self.sheet.v_max * (1 + 1e-9)
        assert abs(command.omega) <= self.sheet.omega_max * (1 + 1e-9)
        passed = self.steady - self.last_sent + STAMP_JITTER
        if not self.is_simulated and command != (0.0, 0.0):
            assert abs(command.v - self.last.v) <= self.sheet.a_max * passed + 1e-9, "acceleration"
            assert abs(command.omega - self.last.omega) <= self.sheet.omega_dot_max * passed + 1e-9, "acceleration"
        if command != self.last:
            self.last, self.last_sent = command, self.steady

    def tick(self):
        command = self.supervisor.on_tick(self.now, self.steady, self.rng.random() < 0.01)
        assert command in (None, (0.0, 0.0))
        if command is not None:
            self.check_bounds(command)

    def check(self):
        supervisor = self.supervisor
        if self.rng.random() < 0.1:
            assert all(isinstance(one, str) for pair in supervisor.description().items() for one in pair)
        self.taken += supervisor.goals.take_news()
        present, state = supervisor.goals.present, supervisor.state
        self.states.add(supervisor.status)
        assert len(self.taken) + (present is not None) == self.number, "each goal ends once"
        assert (supervisor.goal is not None) == (state in WITH_GOAL), state
        if present is not None:
            assert state in (State.DRIVING, State.STOPPING), state
            assert present.is_cancelling == (state is State.STOPPING), state
        elif state is State.DRIVING:
            raise AssertionError("driving without a goal")

    def run(self):
        rng = self.rng
        for _ in range(EVENTS):
            self.wait()
            kind = rng.random()
            if kind < 0.06:
                self.goal()
            elif kind < 0.08:
                self.sent(self.supervisor.on_cancel("by the test"))
            elif kind < 0.083:
                self.supervisor.on_stop("by the end of the node")
            elif kind < 0.9:
                self.pose()
            self.tick()
            self.check()

    def wait_for_the_end(self):
        """Let the time pass that was known when the goal was accepted, with random poses."""
        supervisor = self.supervisor
        if supervisor.timeout > LONG:
            self.sent(supervisor.on_cancel("by the test"))
            self.check()
        while supervisor.goals.present is not None:
            within = supervisor.timeout * (max(supervisor.waypoints, 1) if self.config.goal_timeout > 0.0 else 1)
            assert self.counted < within + TICK, "the goal did not end in its time"
            self.pass_time(TICK, TICK)
            if self.rng.random() < 0.5:
                self.stamp += self.rng.choice([1, 0, 10**8])
                self.pose()
            self.tick()
            self.check()


def test_every_goal_ends_once_with_a_reason_within_the_time_known_at_its_acceptance():
    states, ends = set(), set()
    for seed in range(HISTORIES):
        history = History(seed)
        try:
            history.run()
            history.wait_for_the_end()
        except AssertionError as error:
            raise AssertionError(f"history {seed}: {error}") from error
        assert [record.request.id for record in history.taken] == [str(one + 1) for one in range(history.number)], seed
        for record in history.taken:
            assert record.end in ENDS, seed
            assert bool(record.reason) == (record.end != REACHED), (seed, record)
            ends.add(record.end)
        states |= history.states
    assert states == set(STATUS_TEXTS)
    assert ends == set(ENDS) - {REFUSED}
