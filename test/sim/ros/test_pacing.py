"""When the plant steps by a clock."""

import random

import pytest

from diffbot_sim.ros.pacing import CLOCKS, ClockPace


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


def test_without_skips_a_stall_is_made_up_for_a_few_steps_at_a_time():
    # Ten minutes, with a stall of 0.8 s every 30 s: the steps never stay behind the clock by a period.
    pace, taken, now = ClockPace(0.1, 0.0, skips=False), 0, 0.0
    for number in range(1, 6000):
        if number % 300 in range(1, 9):
            continue
        now = 0.1 * number
        due = pace.due(now)
        assert 0 <= due <= 5
        taken += due
        if number % 300 > 12:
            assert taken == number
    assert pace.skipped == 0
