"""Shares of NIS and autocorrelations within their bounds, against scipy's chi-square distribution."""

import numpy as np
import pytest
import scipy.stats
import view_bags

from diffbot_bag.tools.contract_check import Consistency
from diffbot_tools.bag.consistency import observers_for

LABELLED = "std_msgs/msg/Float64MultiArray"
WINDOW = 50


def result(kind, topic, messages):
    observer = observers_for({topic: kind})[topic]
    for message in messages:
        observer.add(5, view_bags.data_of((kind, message)))
    return observer.result()


def nis_message(labels, *data):
    make = view_bags.make
    dims = [make("std_msgs/msg/MultiArrayDimension", label=label, size=1, stride=1) for label in labels]
    return make(LABELLED, layout=make("std_msgs/msg/MultiArrayLayout", dim=dims, data_offset=0), data=np.array(data))


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
    sums = nis[accepted][: len(nis[accepted]) // WINDOW * WINDOW].reshape(-1, WINDOW).sum(1)
    counts = numbers[accepted][: len(sums) * WINDOW].reshape(-1, WINDOW).sum(1)
    inside = (sums >= scipy.stats.chi2.ppf(0.025, counts)) & (sums <= scipy.stats.chi2.ppf(0.975, counts))
    assert result(LABELLED, "/ekf/nis", messages) == Consistency(pytest.approx(inside.mean()), None)
    assert low <= inside.mean() <= high
