"""The lock-step protocol without ROS: when a step is sent, when the robot moves, and with which command."""

import pytest

from diffbot_core.kinematics import Twist
from diffbot_sim.lockstep import MAX_STEPS_WITHOUT_FIX, NO_COMMAND, NO_FILTER, NO_FIX, RESENDS, LockStep


def command(number):
    return Twist(float(number), 0.0)


class FakePlant:
    """Writes down what the protocol does; fixes from step ``first_fix`` on."""

    def __init__(self, first_fix=0, optional=None):
        self.step = 0
        self.first_fix = first_fix
        self.optional = optional or {}
        self.connected = (1, 1, 0, 0, 1)
        self.sent = []
        """step of each sending"""
        self.truths = []
        self.moves = []
        """command of each step"""
        self.reports = []
        self.polling = True

    def advance(self, command):
        self.moves.append(command)
        self.step += 1

    def publish(self):
        self.sent.append(self.step)

    def publish_truth(self):
        self.truths.append(self.step)

    def awaits_first_fix(self):
        return self.step < self.first_fix

    def optional_topics(self):
        return self.optional.get(self.step, set())

    def connections(self):
        return self.connected

    def set_polling(self, active):
        self.polling = active

    def report(self, event):
        self.reports.append(event)


def poll(plant, lockstep, times=1):
    """As the timer does: while it runs."""
    for _ in range(times):
        if plant.polling:
            lockstep.on_poll()


def started(plant=None):
    """A robot whose first step is sent."""
    plant = plant or FakePlant()
    lockstep = LockStep(plant)
    poll(plant, lockstep, 11)
    assert plant.sent == [0]
    return plant, lockstep


def test_the_first_step_is_sent_when_ten_polls_found_the_same_neighbours():
    plant = FakePlant()
    lockstep = LockStep(plant)
    poll(plant, lockstep, 10)
    assert plant.sent == []
    assert set(plant.reports) == {NO_FILTER}
    plant.connected = (2, 1, 0, 0, 1)
    poll(plant, lockstep, 10)
    lockstep.on_command(command(9))
    assert plant.sent == plant.moves == []
    poll(plant, lockstep)
    assert plant.sent == [0]
    assert not plant.polling
    lockstep.on_command(command(1))
    assert plant.moves == [command(1)]


def test_time_passes_without_odometry_until_the_first_fix():
    plant = FakePlant(first_fix=7)
    poll(plant, LockStep(plant), 12)
    assert plant.truths == [0, 1, 2, 3, 4, 5, 6]
    assert plant.moves == [Twist(0.0, 0.0)] * 7
    assert plant.sent == [7]
    assert NO_FIX not in plant.reports


def test_without_any_fix_the_last_awaited_step_is_sent_and_reported_once():
    plant = FakePlant(first_fix=10**9)
    lockstep = LockStep(plant)
    poll(plant, lockstep, 11 + MAX_STEPS_WITHOUT_FIX // 5)
    assert plant.sent == [MAX_STEPS_WITHOUT_FIX]
    assert plant.reports.count(NO_FIX) == 1
    lockstep.on_command(command(1))
    assert plant.sent == [MAX_STEPS_WITHOUT_FIX, MAX_STEPS_WITHOUT_FIX + 1]
    assert plant.reports.count(NO_FIX) == 1


def test_a_topic_that_begins_makes_its_step_doubtful_once():
    # The filter may have answered before the first heading reached it: eleven answers, the last one counts.
    plant, lockstep = started(FakePlant(optional={2: {"headings"}, 3: {"headings"}, 4: {"headings", "landmarks"}}))
    for number in range(1, 3):
        lockstep.on_command(command(number))
    assert plant.step == 2
    for number in range(RESENDS + 1):
        assert plant.step == 2
        assert plant.polling
        assert plant.sent == [0, 1, *[2] * (number + 1)]
        lockstep.on_command(command(100 + number))
        poll(plant, lockstep)
    assert plant.moves == [command(1), command(2), command(100 + RESENDS)]
    assert plant.sent[-1] == 3
    assert not plant.polling
    lockstep.on_command(command(3))
    assert plant.step == 4
    assert plant.polling
    assert lockstep.repeats == 0


def stall(lockstep):
    """Two checks: the first only learns that something happened before it."""
    lockstep.on_stall_check()
    lockstep.on_stall_check()


def test_a_step_without_an_answer_is_sent_again_by_each_check():
    plant, lockstep = started()
    lockstep.on_stall_check()
    assert plant.sent == [0], "it was sent since the last check"
    for number in range(1, 6):
        lockstep.on_stall_check()
        assert plant.sent == [0] * (number + 1)
        assert lockstep.repeats == number
    assert plant.reports[-5:] == [NO_COMMAND] * 5
    assert plant.step == 0


@pytest.mark.parametrize("answers", [1, 2])
def test_late_answers_do_not_put_the_loop_a_step_behind(answers):
    """Sent twice: whether one or both answers come, ten more are asked for and each later command is of its step."""
    plant, lockstep = started()
    stall(lockstep)
    assert plant.sent == [0, 0]
    for _ in range(answers):
        lockstep.on_command(command(-1))
        assert plant.step == 0
    if answers == 1:
        poll(plant, lockstep, 5)
        assert plant.sent == [0, 0], "the second answer may still come"
        stall(lockstep)
        assert plant.sent == [0, 0], "no more answers come: one is enough"
    assert plant.polling
    for number in range(RESENDS):
        poll(plant, lockstep)
        assert plant.sent == [0] * (3 + number)
        lockstep.on_command(command(number))
    assert plant.moves == [command(RESENDS - 1)]
    for number in range(20, 30):
        lockstep.on_command(command(number))
        assert plant.moves[-1] == command(number)
        assert plant.sent[-2:] == [plant.step - 1, plant.step]
    assert lockstep.repeats == 1


def test_a_pause_holds_the_step_its_answer_counts_at_its_end_and_an_unanswered_one_is_not_sent_again_in_it():
    plant, lockstep = started()
    lockstep.set_paused(True)
    lockstep.on_command(command(1))
    stall(lockstep)
    assert (plant.moves, plant.sent) == ([], [0])
    lockstep.set_paused(False)
    assert (plant.moves, plant.sent) == ([command(1)], [0, 1])
    plant, lockstep = started()
    lockstep.set_paused(True)
    stall(lockstep)
    stall(lockstep)
    assert (plant.sent, lockstep.repeats) == ([0], 0)
    lockstep.set_paused(False)
    lockstep.on_stall_check()
    assert (plant.sent, lockstep.repeats) == ([0, 0], 1)


def test_after_a_reset_all_begins_again_and_answers_to_what_was_sent_before_move_nothing():
    plant, lockstep = started(FakePlant(optional={0: {"headings"}, 1: {"headings"}}))
    lockstep.on_command(command(1))
    plant.step = 0
    plant.sent.clear()
    lockstep.reset()
    assert plant.polling
    lockstep.on_command(command(50))
    poll(plant, lockstep, 9)
    lockstep.on_command(command(51))
    assert plant.sent == plant.moves == []
    poll(plant, lockstep, 2)
    assert plant.sent == [0]
    assert plant.polling, "the filter may have been reset too: the first headings are sent until they are surely there"
    lockstep.on_command(command(2))
    assert plant.moves == []


def test_a_resend_waits_for_its_own_answer_also_after_a_pause():
    plant, lockstep = started(FakePlant(optional={0: {"headings"}}))
    lockstep.set_paused(True)
    lockstep.on_command(command(1))
    poll(plant, lockstep, 5)
    lockstep.set_paused(False)
    assert (plant.sent, plant.moves) == ([0], [])
    poll(plant, lockstep, 6)
    assert plant.sent == [0, 0]
