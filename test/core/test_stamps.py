"""Stamps: repeated and late messages, clocks that are set, and offsets between clocks."""

import math

import numpy as np
import pytest

from diffbot_core.stamps import ForwardSteps, Lateness, RelativeClocks, StampWatch

NOW = 1_800_000_000 * 10**9


def test_only_a_stamp_later_than_all_others_advances_until_time_is_restarted():
    watch = StampWatch()
    #         first, later, again, out of order, again, later | restart by more than a second, and on
    stamps = [5_000_000_000, 5_100_000_000, 5_100_000_000, 5_000_000_000, 5_100_000_000, 5_200_000_000, 0, 0, 1]
    assert [watch.advances(stamp) for stamp in stamps] == [True, True, False, False, False, True, False, False, True]


def test_a_clock_that_is_set_back_by_less_than_a_second_advances_from_the_third_message_on():
    watch, period = StampWatch(), 50_000_000
    for number in range(40):
        assert watch.advances(number * period)
    assert [watch.advances((number - 16) * period) for number in range(40, 45)] == [False, False, True, True, True]
    # Two senders, one of them behind: only the other one advances.
    two = StampWatch()
    both = [stamp for number in range(20, 40) for stamp in (number * period, (number - 10) * period)]
    assert [two.advances(stamp) for stamp in both] == [True, False] * 20


def late(offset, arrivals):
    """Lateness of messages given as (stamp [s], delay [s]); the sender's clock is ``offset`` [s] ahead."""
    lateness = Lateness()
    return [lateness.next(round((stamp + offset) * 1e9), stamp + delay) for stamp, delay in arrivals]


@pytest.mark.parametrize("offset", [0.0, -3600.0, 1.8e9])
def test_lateness_is_the_excess_over_the_smallest_delay_even_in_a_burst_after_silence(offset):
    usual = [(0.1 * number, 0.03 + 0.01 * (number % 3)) for number in range(50)]
    burst = [(5.0 + 0.1 * number, 6.0 - 0.1 * number) for number in range(20)]
    found = late(offset, [*usual, *burst])
    assert found[3:] == pytest.approx([delay - 0.03 for _, delay in (*usual[3:], *burst)], abs=1e-6)


def test_a_larger_delay_becomes_usual_within_seconds_and_a_clock_set_back_at_once():
    found = late(0.0, [(0.1 * number, 0.03 if number < 30 else 0.83) for number in range(100)])
    assert found[30:40] == pytest.approx([0.8] * 10)
    assert found[80:] == pytest.approx([0.0] * 20)
    lateness = Lateness()
    messages = [(1.0, 90.0), (1.1, 90.1), (1.2, 20.0)]
    assert [lateness.next(round(stamp * 1e9), now) for now, stamp in messages] == [0.0] * 3


def passed(stamps, arrivals):
    watch = ForwardSteps()
    return [watch.passed(NOW + round(1e9 * stamp), now) for stamp, now in zip(stamps, arrivals, strict=True)]


@pytest.mark.parametrize("step", [0.3, 30.0, 2000.0])
def test_a_clock_that_is_set_forward_is_detected_with_the_true_time_that_passed(step):
    times = np.arange(0.0, 6.0, 0.05)
    delays = np.random.default_rng(2).exponential(0.01, len(times))
    found = passed(times + step * (times > 3.0), times + delays)
    assert np.flatnonzero(np.isfinite(found)) == [61]
    assert found[61] == pytest.approx(0.05, abs=0.03)


def test_a_gap_a_burst_and_delayed_messages_are_not_a_forward_step():
    times = np.arange(0.0, 12.0, 0.05)
    gap = times[(times < 4.0) | (times > 4.9)]
    burst = np.ceil(times / 0.4 + 1e-9) * 0.4
    # A busy machine: every message is 0.5 s late for five seconds.
    busy = np.where((times > 3.0) & (times < 8.0), times + 0.5, times)
    for stamps, arrivals in ((gap, gap + 0.01), (times, burst), (times, np.maximum.accumulate(busy))):
        assert all(math.isinf(one) for one in passed(stamps, arrivals))


def offsets(seconds, sent, step_at=math.inf, step=0.0):
    """Return the offsets to odom after each window of 2 s; ``sent`` maps an input to rate [Hz], offset and delay [s].

    The receiver and the senders share a clock except for the offsets. It is set by ``step`` [s] at ``step_at`` [s].
    """
    found, clocks, random = [], RelativeClocks(), np.random.default_rng(1)
    for tick in range(round(100 * seconds)):
        time = 0.01 * tick
        for name, (rate, offset, delay) in sent.items():
            if tick % round(100 / rate) == 0:
                age = delay + random.exponential(0.02)
                stamp = NOW + round((time + offset + step * (time - age > step_at)) * 1e9)
                clocks.add(name, stamp, NOW + round((time + age + step * (time > step_at)) * 1e9))
        if tick % 200 == 199:
            clocks.end_window()
            found.append(clocks.ahead_of("odom"))
    return found


def test_the_offset_between_clocks_is_found_at_any_rate_and_delay():
    found = offsets(10.0, {"odom": (50, -0.4, 0.0), "fix": (5, 0.0, 0.01), "imu": (100, -0.4, 0.0)})
    assert found[0] == {}
    assert found[-1]["fix"] == pytest.approx(0.4, abs=0.05)
    assert found[-1]["imu"] == pytest.approx(0.0, abs=0.02)
    assert offsets(10.0, {"odom": (20, 3600.0, 0.0), "fix": (1, 0.0, 0.0)})[-1]["fix"] == pytest.approx(-3600, abs=0.1)


@pytest.mark.parametrize("step", [200.0, -0.8, -5.0, 0.8])
def test_a_step_of_the_receivers_clock_is_not_an_offset(step):
    sent = {"odom": (50, 0.0, 0.0), "fix": (2, 0.0, 0.05)}
    for at in (5.0, 5.9, 6.0, 6.1):
        assert all(abs(one.get("fix", 0.0)) < 0.1 for one in offsets(14.0, sent, at, step)), at


def test_a_single_latched_fix_and_a_silent_input_have_no_offset():
    clocks = RelativeClocks()
    clocks.add("fix", NOW - 600 * 10**9, NOW)
    for second in range(6):
        clocks.add("odom", NOW + second * 10**9, NOW + second * 10**9)
        clocks.end_window()
    assert clocks.ahead_of("odom") == {}
    assert clocks.ahead_of("joint_states") == {}
