"""Share of the mean NIS within their bounds, against scipy's chi-square distribution."""

import numpy as np
import pytest
import scipy.stats

from diffbot_bag.messages import make
from diffbot_tools.bag.consistency import share_of_windows

WINDOW = 50


def nis_message(labels, *data):
    return make("std_msgs/msg/Float64MultiArray", layout={"dim": [{"label": label} for label in labels]}, data=data)


@pytest.mark.parametrize(("scale", "low", "high"), [(1.0, 0.9, 1.0), (1.3, 0.1, 0.8)])
def test_share_of_the_windows_of_single_measurements(scale, low, high):
    random = np.random.default_rng(7)
    numbers = random.integers(1, 4, 1200)
    nis = scale * random.chisquare(numbers)
    accepted = random.random(1200) < 0.9
    messages = [
        nis_message(("nis", "numbers", "accepted"), value, float(count), float(good))
        for value, count, good in zip(nis, numbers, accepted, strict=True)
    ]
    messages.insert(5, nis_message(("other",), 1.0))
    sums = nis[accepted][: len(nis[accepted]) // WINDOW * WINDOW].reshape(-1, WINDOW).sum(1)
    counts = numbers[accepted][: len(sums) * WINDOW].reshape(-1, WINDOW).sum(1)
    inside = (sums >= scipy.stats.chi2.ppf(0.025, counts)) & (sums <= scipy.stats.chi2.ppf(0.975, counts))
    assert share_of_windows(messages) == pytest.approx(inside.mean())
    assert low <= inside.mean() <= high
