"""Shares of NIS and autocorrelations within their bounds, against scipy's chi-square distribution."""

import numpy as np
import pytest
import scipy.stats
import view_bags

from diffbot_bag.tools.contract_check import Consistency
from diffbot_tools.bag.consistency import observers_for

STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
LABELLED = "std_msgs/msg/Float64MultiArray"
WINDOW = 50


def result(kind, topic, messages):
    observer = observers_for({topic: kind})[topic]
    for message in messages:
        observer.add(5, bytes(view_bags.STORE.serialize_cdr(message, kind)))
    return observer.result()


def status(**values):
    _, message = view_bags.status("ekf", "running")
    message.values = [
        view_bags.make("diagnostic_msgs/msg/KeyValue", key=key.replace("_", " "), value=value)
        for key, value in values.items()
    ]
    return message


def test_shares_of_a_status():
    bounds = {"NIS_95_%_bounds": "0.700 1.300"}
    whites = [
        {"autocorrelation of fixes": number, "autocorrelation of fixes, 95 % bound": "0.196"}
        for number in ("0.195", "-0.195", "0.2", "-0.3")
    ]
    messages = [status(NIS_per_number=nis, **bounds) for nis in ("0.7", "1.3", "0.69", "1.31", "1.0")]
    assert result(STATUS, "/ekf/status", messages) == Consistency(0.6, None)
    assert result(STATUS, "/ekf/status", [status(**one) for one in whites]) == Consistency(None, 0.5)
    # One of another node shows nothing.
    messages = [status(), status(NIS_per_number="high"), status(NIS_per_number="1.0")]
    assert result(STATUS, "/controller/status", messages) == Consistency(None, None)


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


def test_numbers_with_other_labels_show_nothing():
    messages = [nis_message(("a", "b", "c"), 1.0, 2.0, 1.0)] * 60
    assert result(LABELLED, "/ekf/nis", messages) == Consistency(None, None)
    observer = observers_for({"/ekf/nis": LABELLED})["/ekf/nis"]
    observer.add(1, b"\0\1\0\0\xff\xff\xff\xff")
    assert observer.result() == Consistency(None, None)
