"""The gate, its slack and relocation, against chi-square quantiles, counting by hand and a second filter."""

import math

import numpy as np
import pytest
from filter_runs import gated_filter, heading, straight
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from diffbot_control.filter.gate import (
    ACCEPTED,
    IGNORED,
    REJECTED,
    RELOCATED,
    WEIGHED,
    Decision,
    GateMemory,
    RejectionStreak,
    age,
    decide_fix,
    decide_other,
    decide_weight,
    new_gate,
)
from diffbot_control.filter.options import EKF, FNN_CALIBRATING, FilterConfig, options_of

BOTH = pytest.mark.parametrize("variant", [EKF, FNN_CALIBRATING])


def options(**values):
    return options_of(FilterConfig(**values))


NONE = RejectionStreak(0, 0.0)


def decided(memory, expected, agrees, config):
    """Decide on a fix that is far within or far beyond the gates of estimate and candidate."""
    memory, decision = decide_fix(memory, 0.5 if expected else 1e9, 0.5 if agrees else 1e9, config.gates[2], config)
    assert decision.agrees <= agrees
    return memory, decision.outcome


TRIES = st.lists(st.tuples(st.booleans(), st.booleans(), st.floats(0.0, 1.0)), max_size=40)


@settings(max_examples=100)
@given(TRIES, st.integers(2, 4), st.sampled_from((0.05, 0.5, 2.0)))
def test_the_memory_of_the_gate_is_what_a_count_of_its_history_says(tries, wanted, timeout):
    config = options(relocation_fixes=wanted, relocation_timeout=timeout)
    gate, history, time = new_gate(), [], 0.0
    for expected, agrees, dt in tries:
        gate, time = age(gate, dt), time + dt
        gate, verdict = decided(gate, expected, agrees and bool(history), config)
        if expected:
            assert verdict == ACCEPTED
            history = []
        else:
            history.append((time, agrees and bool(history)))
            run = 1
            while run < len(history) and history[-run][1]:
                run += 1
            since = time - history[0][0]
            if abs(since - timeout) < 1e-9:
                return  # rounding decides
            assert verdict == (RELOCATED if run >= wanted or (len(history) >= wanted and since > timeout) else REJECTED)
            if verdict == RELOCATED:
                history = []
        assert gate.fixes.rejected == len(history)
        assert gate.fixes.elapsed == pytest.approx(time - history[0][0] if history else 0.0, abs=1e-9)
        assert gate.slack >= 0.0


def test_slack_by_hand():
    config, gate, seen = options(relocation_fixes=3, relocation_timeout=100.0), new_gate(), []
    steps = [False] * 4 + [True] * 10 + [False] + [True] * 20
    for expected in steps:
        gate, _ = decided(gate, expected, False, config)
        seen.append(gate.slack)
    expected = [0.2, 0.4, 0.6, 0.8, *np.arange(0.75, 0.25, -0.05), 0.5, *np.arange(0.45, 0.0, -0.05), *[0.0] * 11]
    assert seen == pytest.approx(expected, abs=1e-9)
    assert gate.slack == 0.0


@pytest.mark.parametrize("is_fix", [True, False])
@pytest.mark.parametrize("numbers", [1, 2, 3])
def test_the_gate_is_the_quantile_of_the_numbers_widened_for_fixes_only(numbers, is_fix):
    config = options(gate_probability=0.99)
    for slack in (0.0, 0.7):
        memory, quantile = GateMemory(NONE, 0, slack, NONE), chi2.ppf(0.99, numbers)
        bound = quantile * (math.exp(slack) if is_fix else 1.0)

        def decision(nis, memory=memory, gate=config.gates[numbers - 1]):
            if is_fix:
                return decide_fix(memory, nis, math.nan, gate, config)[1]
            return decide_other(memory, nis, gate, config)[1]

        for nis, outcome in ((0.0, ACCEPTED), (0.999 * bound, ACCEPTED), (1.001 * bound, REJECTED)):
            assert decision(nis) == Decision(outcome, False)
        for nis in (math.nan, -1e-6):
            assert decision(nis).outcome == REJECTED


@pytest.mark.parametrize(("share", "agrees"), [(0.99, True), (1.01, False), (math.nan, False)])
def test_a_fix_agrees_only_within_the_candidates_gate(share, agrees):
    config, memory = options(relocation_fixes=5), GateMemory(RejectionStreak(1, 0.0), 1, 0.0, NONE)
    decision = decide_fix(memory, 1e6, share * chi2.ppf(0.999, 3), config.gates[2], config)[1]
    assert decision == Decision(REJECTED, agrees)


def test_a_weighed_landmark_is_never_rejected_but_for_a_nis_that_is_none_and_ignored_under_the_robot():
    gate, memory = options().gates[1], GateMemory(NONE, 0, 0.0, RejectionStreak(2, 1.0))
    assert decide_weight(memory, 1e9, gate) == (new_gate(), Decision(WEIGHED, False))
    assert decide_weight(memory, 0.5, gate) == (new_gate(), Decision(ACCEPTED, False))
    assert decide_weight(memory, math.nan, gate) == (memory, Decision(REJECTED, False))
    assert decide_weight(memory, math.inf, gate) == (memory, Decision(IGNORED, False))


@BOTH
def test_headings_that_contradict_for_long_open_the_pose(variant):
    timeout = 1.0
    found = gated_filter(variant, (1.0, 2.0, 0.0), 1e-4 * np.eye(3), relocation_timeout=timeout)
    wheels = found.memory.belief
    for number in range(round(8 * timeout) + 1):
        found.predict(straight(dt=0.125, variance=0.0))
        before = found.memory.belief
        verdict = found.take(heading(2.0, 0.01))
        if number < 8 * timeout:
            assert verdict == REJECTED
            assert found.memory.belief is before
            assert found.memory.gate.others == RejectionStreak(number + 1, number * 0.125)
    assert verdict == RELOCATED
    assert found.memory.gate.others == RejectionStreak(0, 0.0)
    # A prior of (1 rad)^2 and one heading of variance 0.01; nothing is known of the position, and nothing correlates.
    x, P = found.memory.belief
    np.testing.assert_allclose(x[:3], [1.0, 2.0, 2.0 / 1.01])
    expected = np.zeros_like(P)
    expected[:3, :3] = np.diag([25.0, 25.0, 0.01 / 1.01])
    expected[3:, 3:] = before.P[3:, 3:]
    np.testing.assert_allclose(P, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(x[3:], wheels.x[3:])
