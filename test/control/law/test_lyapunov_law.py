"""sinc and tanhc of the paper's laws, against exact series."""

from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law.lyapunov_law import sinc, tanhc

CHECK = settings(max_examples=150)


@CHECK
@given(st.floats(1e-8, 1e-2))
def test_sinc_and_tanhc_against_exact_series(x):
    # Taylor series in exact fractions; the rest is below x^8 = 1e-16 of the value.
    square = Fraction(x) ** 2
    sine = 1 - square / 6 + square**2 / 120 - square**3 / 5040
    tangent = 1 - square / 3 + 2 * square**2 / 15 - 17 * square**3 / 315
    assert sinc(x) == pytest.approx(float(sine), rel=3e-16)
    assert tanhc(x) == pytest.approx(float(tangent), rel=3e-16)
    assert sinc(-x) == sinc(x)
    assert tanhc(-x) == tanhc(x)
    assert sinc(0.0) == tanhc(0.0) == 1.0
