"""Lock-step protocol without ROS: when a step is sent, when the robot moves, and with which command."""

from diffbot_core.kinematics import Twist
from diffbot_sim.lockstep import (
    MAX_STEPS_WITHOUT_FIX,
    NO_COMMAND,
    NO_FILTER,
    NO_FIX,
    SETTLED_POLLS,
    STALLED_CHECKS,
    LockStep,
)

STOP = Twist(0.0, 0.0)


def command(number):
    return Twist(float(number), 0.0)


class FakePlant:
    """Records the calls of the protocol. Fixes arrive from step ``first_fix`` on."""

    def __init__(self, first_fix=0):
        self.step, self.first_fix, self.connected = 0, first_fix, (1, 1, 0, 0, 1)
        self.sent, self.truths, self.moves, self.reports = [], [], [], []
        """steps that were sent with and without odometry, the command of each step, and events"""
        self.report = self.reports.append

    @property
    def stamp(self):
        return self.step * 10**8

    def advance(self, command):
        self.moves.append(command)
        self.step += 1

    def publish(self):
        self.sent.append(self.step)

    def publish_truth(self):
        self.truths.append(self.step)

    def awaits_first_fix(self):
        return self.step < self.first_fix

    def connections(self):
        return self.connected


def poll(lockstep, times=1):
    for _ in range(times):
        lockstep.on_poll()


def started():
    """Return plant and protocol after the first step was sent."""
    plant = FakePlant()
    lockstep = LockStep(plant)
    poll(lockstep, SETTLED_POLLS + 1)
    assert plant.sent == [0]
    return plant, lockstep


def test_the_first_step_is_sent_after_enough_polls_with_the_same_connections():
    plant = FakePlant()
    lockstep = LockStep(plant)
    poll(lockstep, SETTLED_POLLS)
    assert plant.sent == []
    assert set(plant.reports) == {NO_FILTER}
    plant.connected = (2, 1, 0, 0, 1)
    poll(lockstep, SETTLED_POLLS)
    lockstep.on_command(command(9), 0)
    assert plant.sent == plant.moves == []
    poll(lockstep)
    assert plant.sent == [0]
    poll(lockstep, 20)
    assert plant.sent == [0]
    lockstep.on_command(command(1), 0)
    assert plant.moves == [command(1)]


def test_the_plant_sends_no_odometry_before_the_first_fix():
    plant = FakePlant(first_fix=7)
    poll(LockStep(plant), SETTLED_POLLS + 2)
    assert plant.truths == [0, 1, 2, 3, 4, 5, 6]
    assert plant.moves == [STOP] * 7
    assert plant.sent == [7]
    assert NO_FIX not in plant.reports


def test_without_fixes_the_wait_ends_and_is_reported_once():
    plant = FakePlant(first_fix=10**9)
    lockstep = LockStep(plant)
    poll(lockstep, SETTLED_POLLS + 1 + MAX_STEPS_WITHOUT_FIX // 5)
    assert plant.sent == [MAX_STEPS_WITHOUT_FIX]
    lockstep.on_command(command(1), plant.stamp)
    assert plant.sent == [MAX_STEPS_WITHOUT_FIX, MAX_STEPS_WITHOUT_FIX + 1]
    assert plant.reports.count(NO_FIX) == 1


def test_an_answer_to_another_step_is_ignored():
    plant, lockstep = started()
    lockstep.on_command(command(1), 0)
    lockstep.on_command(command(2), 0)
    assert plant.step == 1
    lockstep.on_command(command(3), 10**8)
    assert plant.moves == [command(1), command(3)]
    assert plant.sent == [0, 1, 2]


def stall(lockstep, times):
    for _ in range(times):
        lockstep.on_stall_check()


def test_a_step_without_an_answer_does_not_stop_the_simulation():
    plant, lockstep = started()
    stall(lockstep, STALLED_CHECKS - 1)
    assert (plant.moves, plant.reports.count(NO_COMMAND)) == ([], 0)
    stall(lockstep, 1)
    assert (plant.moves, plant.reports.count(NO_COMMAND), lockstep.unanswered) == ([STOP], 1, 1)
    # Without answers, each further check moves the robot.
    stall(lockstep, 3)
    assert plant.moves == [STOP] * 4
    lockstep.on_command(command(5), 0)
    assert plant.step == 4, "a late answer to an earlier step is ignored"
    lockstep.on_command(command(6), 4 * 10**8)
    assert plant.moves[4:] == [command(6)]
    stall(lockstep, STALLED_CHECKS - 1)
    assert plant.step == 5, "the protocol waits again"


def test_an_answer_in_a_pause_moves_the_robot_after_the_pause():
    plant, lockstep = started()
    lockstep.set_paused(True)
    lockstep.on_command(command(1), 0)
    stall(lockstep, 20)
    assert (plant.moves, plant.sent) == ([], [0])
    lockstep.set_paused(False)
    assert (plant.moves, plant.sent) == ([command(1)], [0, 1])
    lockstep.set_paused(True)
    stall(lockstep, 20)
    lockstep.set_paused(False)
    assert (plant.moves, lockstep.unanswered) == ([command(1)], 0)


def test_after_a_reset_the_protocol_starts_again_and_ignores_old_answers():
    plant, lockstep = started()
    lockstep.on_command(command(1), 0)
    stall(lockstep, STALLED_CHECKS)
    plant.step = 0
    plant.sent.clear()
    plant.moves.clear()
    lockstep.reset()
    lockstep.on_command(command(50), 0)
    poll(lockstep, SETTLED_POLLS - 1)
    lockstep.on_command(command(51), 0)
    stall(lockstep, 20)
    assert plant.sent == plant.moves == []
    poll(lockstep, 2)
    assert plant.sent == [0]
    lockstep.on_command(command(2), 0)
    assert (plant.moves, lockstep.unanswered) == ([command(2)], 0)
