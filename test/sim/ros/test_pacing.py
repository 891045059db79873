"""When the plant steps by a clock of its own, and by another one's."""

import random

from diffbot_sim.ros.foreign_clock import ForeignClock
from diffbot_sim.ros.pacing import ClockPace

MS = 10**6
START = 1_700_000_000 * 10**9 + 123_456_789
"""A time of day, where floats are coarse."""


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


def test_steps_are_due_when_the_clock_has_passed_their_time():
    clock = ForeignClock(100 * MS)
    assert clock.on_clock(START) is None
    # The other plant steps by 50 ms: every second reading is a step, but only once.
    assert [clock.on_clock(START + k * 50 * MS) for k in (1, 2, 2, 3, 4)] == [0, 1, 0, 0, 1]


def test_time_that_jumps_back_or_a_pause_begins_again():
    clock = ForeignClock(100 * MS)
    clock.on_clock(START)
    assert clock.on_clock(START - 500 * MS) is None
    assert clock.on_clock(START - 400 * MS) == 1
    clock.restart()
    assert clock.on_clock(START + 3600 * 1000 * MS) is None
    assert clock.on_clock(START + 3600 * 1000 * MS + 100 * MS) == 1


def test_a_jump_ahead_by_hours_takes_a_bounded_number_of_steps():
    clock = ForeignClock(100 * MS)
    clock.on_clock(START)
    assert clock.on_clock(START + 3600 * 1000 * MS) == 1000
    assert clock.skipped == 35_000
