"""The verdict of the soak: memory that grows, threads and descriptors that do, goals that are not reached."""

import pytest
import soak
from soak_graph import MAX_SLOPE, growth


def samples(slope, threads=lambda _: 16, descriptors=lambda _: 18, outlier=0.0):
    """Return five minutes of samples, memory growing by ``slope`` [MB/min]."""
    found = [(2.0 * n, 70.0 + slope * n / 30.0, threads(n), descriptors(n)) for n in range(150)]
    found[75] = (found[75][0], found[75][1] + outlier, *found[75][2:])
    return found


def result(reached=3, defects=(), **options):
    goals = {"no fault": {"sent": 3, "reached": reached}}
    return {"goals": goals, "nodes": {"ekf": growth(samples(**options))}, "defects": list(defects)}


@pytest.mark.parametrize("slope", [-0.1, 0.0, 0.25, 0.5])
def test_slope_of_the_memory_is_found_past_an_outlier(slope):
    found = growth(samples(slope, outlier=50.0))
    assert found["slope"] == pytest.approx(slope, abs=1e-6)
    assert found["minutes"] == pytest.approx(298.0 / 60.0)


def test_nothing_is_broken_when_all_is_well():
    assert soak.broken_promises(result(slope=0.9 * MAX_SLOPE)) == []


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"slope": 0.4}, "ekf: RSS grows by 0.400 MB/min, allowed 0.3"),
        ({"slope": 0.0, "threads": lambda n: 16 + n // 100}, "ekf: threads grew from 16 to 17"),
        ({"slope": 0.0, "descriptors": lambda n: 18 + n // 30}, "ekf: descriptors grew from 19 to 21"),
        ({"slope": 0.0, "reached": 2}, "no fault: 2 of 3 goals reached"),
        ({"slope": 0.0, "defects": ["2 tracebacks in the logs"]}, "2 tracebacks in the logs"),
    ],
)
def test_each_broken_promise_is_one_line(options, line):
    assert soak.broken_promises(result(**options)) == [line]
