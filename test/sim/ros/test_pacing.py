"""When the plant steps by a clock."""

import random

from diffbot_sim.ros.pacing import ClockPace


def test_a_jittering_timer_takes_one_step_each_time():
    # Up to 4 ms late or early, as a timer of the same period does; the beat is the clock's.
    rng = random.Random(1)
    pace = ClockPace(0.1, 0.0)
    assert pace.due(0.05) == 0
    assert {pace.due(0.1 * number + rng.uniform(-0.004, 0.004)) for number in range(1, 3_600)} == {1}
    assert pace.skipped == 0


def test_a_late_caller_catches_up_and_a_very_late_one_skips_the_rest():
    pace = ClockPace(0.1, 0.0)
    assert [pace.due(time) for time in (0.35, 0.37, 0.41, 0.95)] == [3, 0, 1, 5]
    assert pace.skipped == 0
    assert pace.due(2.95) == 5
    assert pace.skipped == 15
    assert [pace.due(time) for time in (2.97, 3.01, 3.65)] == [0, 1, 5]
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
