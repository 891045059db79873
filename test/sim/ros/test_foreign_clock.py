"""A plant that takes its steps by another one's clock."""

from diffbot_sim.ros.foreign_clock import ForeignClock

MS = 10**6
START = 1_700_000_000 * 10**9 + 123_456_789
"""A time of day, where floats are coarse."""


def test_steps_are_due_when_the_clock_has_passed_their_time():
    clock = ForeignClock(100 * MS)
    assert clock.on_clock(START) is None
    # The other plant steps by 50 ms: every second reading is a step, but only once.
    assert [clock.on_clock(START + k * 50 * MS) for k in (1, 2, 2, 3, 4)] == [0, 1, 0, 0, 1]


def test_a_clock_of_long_steps_makes_several_due_and_none_is_skipped():
    clock = ForeignClock(10 * MS)
    clock.on_clock(START)
    assert [clock.on_clock(START + k * 1000 * MS) for k in (1, 2)] == [100, 100]
    assert clock.skipped == 0


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
