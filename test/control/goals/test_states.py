"""The table of states: what it must say, and what random hostile histories make of it.

``DIFFBOT_HISTORIES=100000 pytest test/control/goals/test_states.py`` tries as many histories; `make test` a few.
"""

import math
import os
import random
from typing import NamedTuple

import pytest

from diffbot_control.goals import ENDS, STATUS_TEXTS, TABLE, Event, GoalRequest, State, Supervisor, SupervisorConfig
from diffbot_control.goals.goal_record import CANCELLED, REACHED
from diffbot_control.goals.states import OPEN, WITH_GOAL, Command
from diffbot_control.law import PRESETS, SwitchingLaw
from diffbot_control.law.configuration import Report
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.stamps import StampWatch
from diffbot_core.uncertainty import Uncertainty

HISTORIES = int(os.environ.get("DIFFBOT_HISTORIES", "500"))
STAMP_JITTER = 0.05
"""[s] by which stamps may run ahead of the time that has passed"""
EVENTS = 60
"""Of a history, before it is waited for the last answer."""
SLOW = PRESETS["tuned"]._replace(
    tolerance=PRESETS["tuned"].tolerance._replace(settling_steps=2),
    data_sheet=DataSheet(v_max=0.7, omega_max=1.5, a_max=0.5, omega_dot_max=1.5),
)


class FoolConfig(NamedTuple):
    data_sheet: DataSheet = DataSheet(v_max=0.7, omega_max=1.5, a_max=0.5, omega_dot_max=1.5)


class FoolMemory(NamedTuple):
    reached: bool = False


class Fool:
    """A law of others that does anything: raises, says nonsense, reaches goals from afar, spins for ever."""

    name = "fool"
    Config = FoolConfig

    def __init__(self, rng, is_tame):
        self.rng, self.is_tame = rng, is_tame

    def new_memory(self, config):
        if not self.is_tame and self.rng.random() < 0.02:
            raise ZeroDivisionError
        return FoolMemory()

    def step(self, memory, estimate, goal, dt, config):
        if not self.is_tame and self.rng.random() < 0.02:
            raise ValueError("no idea")
        v = math.nan if not self.is_tame and self.rng.random() < 0.02 else self.rng.uniform(-9.0, 9.0)
        report = Report(math.dist(estimate.pose[:2], goal[:2]), 0.0, 0.0, 0.0, 0.0, 0, 0.0)
        return FoolMemory(memory.reached or self.rng.random() < 0.01), Twist(v, self.rng.uniform(-9.0, 9.0)), report


class History:
    """A supervisor as the node calls it, with clocks, stamps, poses and covariances of any kind."""

    def __init__(self, seed):
        self.rng = rng = random.Random(seed)
        own = rng.random() < 0.6
        law = SwitchingLaw if own else Fool(rng, is_tame=True)
        controller = rng.choice([SLOW, PRESETS["paper"]]) if own else FoolConfig()
        self.config = SupervisorConfig(
            controller=controller,
            pose_lost_timeout=rng.choice([0.0, 2.0, 30.0]),
            goal_timeout=rng.choice([-1.0, -1.0, 3.0, 20.0]),
            waypoint_radius=rng.choice([0.0, 0.5]),
            hold_goal=rng.random() < 0.7,
            publish_when_idle=rng.random() < 0.3,
        )
        self.supervisor = Supervisor(self.config, law)
        if not own:
            law.is_tame = False
        self.sheet = controller.data_sheet
        self.is_simulated = rng.random() < 0.3
        self.last, self.last_sent = Twist(0.0, 0.0), -math.inf
        self.steady = rng.uniform(0.0, 1e6)
        self.now = rng.choice([0.0, 1e3, 1.7e9])
        self.stamp = rng.choice([1, 10**9, int(1.7e18)])
        self.truth = Pose(rng.uniform(-5, 5), rng.uniform(-5, 5), rng.uniform(-3, 3))
        self.stamps, self.last_life = StampWatch(), self.steady
        self.accepted, self.number, self.taken, self.states = self.steady, 0, [], set()

    def wait(self):
        rng = self.rng
        passed = rng.choice([0.02, 0.02, 0.02, 0.1, 0.6, 5.0])
        self.steady += passed
        self.now += passed if rng.random() < 0.95 else rng.uniform(-100.0, 100.0)
        self.stamp += rng.choice([round(passed * 1e9)] * 12 + [0, 0, 1, -(10**9), 10**12])

    def goal(self):
        rng = self.rng
        ahead = [Pose(*(rng.gauss(0.0, rng.choice([0.01, 3.0, 1e6])) for _ in "xyz")) for _ in range(rng.randint(1, 3))]
        if rng.random() < 0.3:
            ahead[0] = self.truth
        self.number += 1
        self.accepted = self.last_goal = self.steady
        request = GoalRequest(str(self.number), "test", rng.choice([self.now, self.now, math.inf]))
        self.supervisor.goals.now = self.now
        if len(ahead) == 1 and rng.random() < 0.8:
            self.supervisor.on_goal(ahead[0], request)
        else:
            self.supervisor.on_path(ahead, request)
        self.last_life = self.steady

    def pose(self):
        rng = self.rng
        if rng.random() < 0.03:
            self.truth = Pose(*(rng.gauss(0.0, rng.choice([0.1, 3.0, 1e9])) for _ in "xyz"))
        sigma = rng.choice([0.0, 0.01, 0.01, 0.03, 1.0, 1e300])
        if self.stamps.advances(self.stamp):
            self.last_life = self.steady
        steady = math.nan if self.is_simulated else self.steady
        self.sent(self.supervisor.on_pose(self.stamp, self.now, self.truth, Uncertainty(sigma, sigma), steady))

    def sent(self, command):
        if command is None:
            return
        self.check_bounds(command)
        x, y, theta = self.truth
        x, y = x + 0.1 * command.v * math.cos(theta), y + 0.1 * command.v * math.sin(theta)
        self.truth = Pose(x, y, theta + 0.1 * command.omega)

    def check_bounds(self, command):
        """In the time since the last command that was another, no bound is broken; zero may be sent at once."""
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
        silence = self.steady - self.last_life
        command = self.supervisor.on_tick(self.now, silence, silence > 0.5, self.steady - self.accepted)
        assert command in (None, (0.0, 0.0))
        if command is not None:
            self.check_bounds(command)

    def check(self):
        supervisor = self.supervisor
        self.taken += supervisor.goals.take_news()
        present, state = supervisor.goals.present, supervisor.state
        self.states.add(supervisor.status)
        assert len(self.taken) + (present is not None) == self.number, "each goal ends once"
        assert (present is not None) == (state in OPEN), state
        assert (supervisor.goal is not None) == (state in WITH_GOAL), state
        assert supervisor.has_failed <= (state is State.GIVEN_UP), state
        if present is not None:
            assert present.is_cancelling == (state is State.CANCELLING)
            assert math.isfinite(supervisor.timeout)

    def run(self):
        rng = self.rng
        for _ in range(EVENTS):
            self.wait()
            kind = rng.random()
            if kind < 0.06:
                self.goal()
            elif kind < 0.08:
                self.sent(self.supervisor.on_cancel())
            elif kind < 0.083:
                self.supervisor.on_stop()
            elif kind < 0.9:
                self.pose()
            self.tick()
            self.check()

    def wait_for_the_answer(self):
        """Let the time pass that was known when the goal was accepted; the sensors do what they like."""
        supervisor = self.supervisor
        while supervisor.goals.present is not None:
            within = supervisor.timeout * (max(supervisor.waypoints, 1) if self.config.goal_timeout > 0.0 else 1)
            assert self.steady - self.accepted < within, "it has no answer in its time"
            self.steady += max(0.25 * within, 0.1)
            if self.rng.random() < 0.5:
                self.stamp += self.rng.choice([1, 0, 10**8])
                self.pose()
            self.tick()
            self.check()


def test_every_goal_of_any_history_ends_once_with_a_reason_in_the_time_known_before():
    states, ends = set(), set()
    for seed in range(HISTORIES):
        history = History(seed)
        try:
            history.run()
            history.wait_for_the_answer()
        except AssertionError as error:
            raise AssertionError(f"history {seed}: {error}") from error
        assert [record.request.id for record in history.taken] == [str(one + 1) for one in range(history.number)], seed
        for record in history.taken:
            assert record.end in ENDS, seed
            assert record.reason or record.end in (REACHED, CANCELLED), (seed, record)
            ends.add(record.end)
        states |= history.states
    assert states == set(STATUS_TEXTS), "the histories come everywhere"
    assert ends == set(ENDS)


@pytest.mark.parametrize("state", sorted(OPEN, key=lambda state: state.value))
def test_silence_a_fault_and_the_nodes_end_stop_the_robot_and_time_ends_the_goal(state):
    row = TABLE[state]
    assert row[Event.OVERDUE].command is Command.ZERO
    assert row[Event.STOP].command is Command.ZERO
    assert row[Event.FAULT].command is Command.BRAKE
    for event in (Event.HOPELESS, Event.LOST, Event.STOP, Event.FAULT):
        assert row[event].answer, event
        assert row[event].state not in OPEN | WITH_GOAL, event
