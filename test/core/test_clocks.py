"""Clocks of several inputs: offsets that last are found; delays, bursts and steps are not taken for offsets."""

import math

import numpy as np
import pytest

from diffbot_core.stamps import ForwardSteps, RelativeClocks

NOW = 1_800_000_000 * 10**9


def offsets(seconds, sent, step_at=math.inf, step=0.0):
    """Return the offsets to odom after each window of 2 s; ``sent`` maps an input to rate [Hz], offset and delay [s].

    The receiver's clock is that of the stamps, and is set by ``step`` [s] at a time.
    """
    found, clocks, random = [], RelativeClocks(), np.random.default_rng(1)
    for tick in range(round(100 * seconds)):
        time = 0.01 * tick
        for name, (rate, offset, delay) in sent.items():
            if tick % round(100 / rate) == 0:
                late = delay + random.exponential(0.02)
                stamp = NOW + round((time + offset + step * (time - late > step_at)) * 1e9)
                clocks.add(name, stamp, NOW + round((time + late + step * (time > step_at)) * 1e9))
        if tick % 200 == 199:
            clocks.end_window()
            found.append(clocks.ahead_of("odom"))
    return found


def test_the_offset_of_a_clock_is_found_whatever_the_rates_and_the_delays_of_single_messages():
    found = offsets(10.0, {"odom": (50, -0.4, 0.0), "fix": (5, 0.0, 0.01), "imu": (100, -0.4, 0.0)})
    assert found[0] == {}
    assert found[-1]["fix"] == pytest.approx(0.4, abs=0.05)
    assert found[-1]["imu"] == pytest.approx(0.0, abs=0.02)
    assert offsets(10.0, {"odom": (20, 3600.0, 0.0), "fix": (1, 0.0, 0.0)})[-1]["fix"] == pytest.approx(-3600, abs=0.1)


@pytest.mark.parametrize("step", [200.0, -0.8, -5.0, 0.8])
def test_a_step_of_the_receivers_clock_is_no_offset(step):
    sent = {"odom": (50, 0.0, 0.0), "fix": (2, 0.0, 0.05)}
    for at in (5.0, 5.9, 6.0, 6.1):
        assert all(abs(one.get("fix", 0.0)) < 0.1 for one in offsets(14.0, sent, at, step)), at


def test_one_latched_fix_and_a_silent_input_are_no_offset():
    clocks = RelativeClocks()
    clocks.add("fix", NOW - 600 * 10**9, NOW)
    for second in range(6):
        clocks.add("odom", NOW + second * 10**9, NOW + second * 10**9)
        clocks.end_window()
    assert clocks.ahead_of("odom") == {}
    assert clocks.ahead_of("joint_states") == {}


def passed(stamps, arrivals):
    watch = ForwardSteps()
    return [watch.passed(NOW + round(1e9 * stamp), now) for stamp, now in zip(stamps, arrivals, strict=True)]


@pytest.mark.parametrize("step", [0.3, 0.8, 30.0, 2000.0])
def test_a_clock_that_is_set_forward_is_found_with_the_time_that_passed(step):
    times = np.arange(0.0, 6.0, 0.05)
    late = np.random.default_rng(2).exponential(0.01, len(times))
    found = passed(times + step * (times > 3.0), times + late)
    assert np.flatnonzero(np.isfinite(found)) == [61]
    assert found[61] == pytest.approx(0.05, abs=0.03)


def test_a_gap_a_burst_and_messages_that_were_held_up_are_no_step():
    times = np.arange(0.0, 12.0, 0.05)
    gap = times[(times < 4.0) | (times > 4.9)]
    assert all(math.isinf(one) for one in passed(gap, gap + 0.01))
    burst = np.ceil(times / 0.4 + 1e-9) * 0.4
    assert all(math.isinf(one) for one in passed(times, burst))
    # A busy machine: every message is 0.5 s late for five seconds, and then all are punctual again.
    busy = np.where((times > 3.0) & (times < 8.0), times + 0.5, times)
    assert all(math.isinf(one) for one in passed(times, np.maximum.accumulate(busy)))
