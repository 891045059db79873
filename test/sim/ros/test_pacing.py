"""When the plant steps: by a clock, or by the controller's answers."""

import random

import pytest

from diffbot_sim.ros.pacing import CLOCKS, ClockPace, LockStep


def test_the_clocks():
    assert CLOCKS == ("wall", "scaled", "lockstep")


def test_a_punctual_timer_takes_one_step_each_time():
    pace = ClockPace(0.125, 10.0)
    assert pace.due(10.0) == 0
    assert pace.due(10.0625) == 0
    assert [pace.due(10.0 + 0.125 * number) for number in range(1, 100)] == [1] * 99
    assert pace.skipped == 0


@pytest.mark.parametrize("early", [0.0, 1e-12, 5e-8, 0.004])
def test_a_timer_a_hair_early_still_takes_its_step(early):
    # Otherwise the steps come in pairs: none now, two next time.
    pace = ClockPace(0.1, 0.0)
    assert [pace.due(0.1 * number - early) for number in range(1, 50)] == [1] * 49


def test_a_jittering_timer_takes_one_step_each_time():
    # Up to 4 ms late or early, as a timer of the same period does; over an hour the beat is the clock's.
    rng = random.Random(1)
    pace = ClockPace(0.1, 0.0)
    assert {pace.due(0.1 * number + rng.uniform(-0.004, 0.004)) for number in range(1, 36_000)} == {1}
    assert pace.skipped == 0


def test_steps_do_not_drift_with_lateness():
    # Each call 30 ms late: the beat stays that of the clock.
    pace = ClockPace(0.1, 0.0)
    assert [pace.due(0.1 * number + 0.03) for number in range(1, 50)] == [1] * 49
    assert pace.due(4.95) == 0
    assert pace.due(5.001) == 1


def test_a_late_caller_catches_up():
    pace = ClockPace(0.1, 0.0)
    assert pace.due(0.35) == 3
    assert pace.due(0.37) == 0
    assert pace.due(0.41) == 1
    assert pace.due(0.95) == 5
    assert pace.skipped == 0


def test_a_very_late_caller_skips_the_rest():
    pace = ClockPace(0.1, 0.0)
    assert pace.due(2.05) == 5
    assert pace.skipped == 15
    assert pace.due(2.07) == 0
    assert pace.due(2.11) == 1
    assert pace.due(2.75) == 5
    assert pace.skipped == 16


def test_a_pause_is_not_caught_up():
    pace = ClockPace(0.1, 0.0)
    assert pace.due(0.11) == 1
    pace.restart(50.0)
    assert pace.due(50.05) == 0
    assert pace.due(50.11) == 1
    assert pace.skipped == 0


def test_lock_step_goes_on_with_the_answer():
    lockstep = LockStep()
    for _ in range(3):
        lockstep.ask()
        assert not lockstep.complete
        lockstep.answer()
        assert lockstep.complete
        assert not lockstep.doubts
        lockstep.next_step()
        assert not lockstep.complete
    assert lockstep.repeats == 0


def test_a_command_that_answers_nothing_is_passed_over():
    lockstep = LockStep()
    lockstep.answer()
    assert not lockstep.complete
    lockstep.ask()
    assert not lockstep.complete
    lockstep.answer()
    assert lockstep.complete
    lockstep.next_step()
    lockstep.answer()
    assert (lockstep.asked, lockstep.answered) == (0, 0)


def stalled_step(answers):
    """A step sent twice, with so many answers."""
    lockstep = LockStep()
    lockstep.ask()
    assert not lockstep.stalled()
    lockstep.ask()
    for _ in range(answers):
        assert not lockstep.complete
        lockstep.answer()
    return lockstep


def test_a_question_asked_twice_wants_two_answers():
    lockstep = stalled_step(answers=2)
    assert lockstep.complete
    assert lockstep.repeats == 1


def test_one_answer_of_two_is_enough_when_no_more_come():
    lockstep = stalled_step(answers=1)
    assert not lockstep.complete
    assert lockstep.stalled()
    assert lockstep.complete
    assert lockstep.repeats == 1


@pytest.mark.parametrize("answers", [1, 2])
def test_a_step_in_doubt_is_asked_again_until_each_of_ten_questions_had_its_own_answer(answers):
    lockstep = stalled_step(answers)
    assert lockstep.complete or lockstep.stalled()
    for left in range(9, -1, -1):
        assert lockstep.ask_once_more()
        assert lockstep.doubts == left
        lockstep.ask()
        assert not lockstep.complete, "what was answered before answers nothing more"
        lockstep.answer()
        assert lockstep.complete
    assert not lockstep.ask_once_more()
    assert lockstep.complete
    lockstep.next_step()
    lockstep.ask()
    lockstep.answer()
    assert not lockstep.ask_once_more()


def test_a_question_without_an_answer_begins_the_doubts_anew():
    lockstep = stalled_step(answers=2)
    for _ in range(4):
        assert lockstep.ask_once_more()
        lockstep.ask()
        lockstep.answer()
    assert lockstep.ask_once_more()
    lockstep.ask()
    assert not lockstep.stalled()
    assert lockstep.doubts == LockStep.DOUBTS == 10
    assert lockstep.repeats == 2


def test_a_step_in_doubt_from_its_beginning_is_asked_eleven_times_and_the_next_one_once():
    lockstep = LockStep()
    lockstep.doubt()
    counts = []
    for _ in range(2):
        count = 0
        while count == 0 or lockstep.ask_once_more():
            lockstep.ask()
            lockstep.answer()
            count += 1
        counts.append(count)
        lockstep.next_step()
    assert counts == [11, 1]
    assert lockstep.repeats == 0
