"""The page of the bounds shows the figures of its JSON."""

import numpy as np
import pytest
from page_tables import assert_shows, tables

from diffbot_lab.benchmark.bound_report import bound_section, laws_ahead
from diffbot_lab.benchmark.law_statistics import figures_of
from diffbot_sim.compiled.batch import COLUMNS


def figures(time, position, settled=40):
    outcomes = np.zeros((40, len(COLUMNS)))
    outcomes[:, COLUMNS.index("settling_time")] = time + 0.1 * np.arange(40)
    outcomes[settled:, COLUMNS.index("settling_time")] = np.nan
    outcomes[:, COLUMNS.index("x")] = position
    return figures_of(outcomes)


@pytest.fixture
def bounds():
    nmpc = [
        {"name": f"nmpc_{feedback}", "label": f"NMPC, {feedback}"} | figures(time, position)
        for feedback, time, position in (("truth", 9.0, 0.01), ("ekf", 10.0, 0.05))
    ]
    least = [
        {"target": "into the tolerance", "confirmed": 17, "median": 9.52, "max": 9.87},
        {"target": "at rest at the pose", "confirmed": 16, "median": 9.63, "max": None},
    ]
    nominal = {"name": "nominal", "text": "-", "least_time": least, "nmpc": nmpc}
    horizon = {"periods": 20, "period": 0.1, "growth": 1.18, "heading_weight": 0.3}
    return {
        "command": "diffbot benchmark bound --runs 2 --seed 7",
        "casadi": "3.8.2",
        "seed": 7,
        "starts": 17,
        "runs_of_each_start": 2,
        "nmpc": horizon | {"stop_distance": 0.03, "stop_angle": 0.03},
        "cases": [nominal, {"name": "mix", "text": "-", "nmpc": nmpc}],
    }


def arena(law):
    names = ("switching", "truth")
    laws = [{"name": name, "label": f"law {name}", "bound": name == "truth"} for name in names]
    row = [{"name": "switching"} | law, {"name": "truth"} | figures(1.0, 0.001)]
    return {"laws": laws, "cases": [{"name": "nominal", "laws": row}]}


def test_the_section_shows_every_figure(bounds):
    least, nmpc = tables("\n".join(bound_section(bounds, arena(figures(12.0, 0.06)))))
    assert [row[:3] for row in least[1:]] == [
        ["nominal", "into the tolerance", "17 of 17"],
        ["nominal", "at rest at the pose", "16 of 17"],
    ]
    assert_shows(least[1][3:], [9.52, 9.87])
    assert_shows(least[2][3:], [9.63, None])
    assert [row[:2] for row in nmpc[1:]] == [
        [case, label] for case in ("nominal", "mix") for label in ("NMPC, truth", "NMPC, ekf")
    ]
    one = bounds["cases"][0]["nmpc"][1]
    values = [100.0, one["settling_time"]["median"], one["settling_time"]["p99"], one["position"]["p95"]]
    assert_shows([cell.split(" [")[0] for cell in nmpc[2][2:6]], values)
    assert nmpc[2][6] == f"{one['reached']} ({one['false_reached']})"
    text = "\n".join(bound_section(bounds, arena(figures(12.0, 0.06))))
    assert bounds["command"] in text
    assert "take 9.52 s" in text
    assert "14.7 s" in text  # 0.1 (1.18^20 - 1) / 0.18


def test_a_law_ahead_of_nmpc_on_the_estimate_is_listed_and_a_bound_is_not(bounds):
    assert laws_ahead(bounds, arena(figures(12.0, 0.06))) == []
    assert laws_ahead(bounds, arena(figures(12.0, 0.04))) == [
        ["nominal", "law switching", "final position error, 95 %", "0.040 m, 0.050 m"]
    ]  # all positions are equal, so the intervals are points
    found = laws_ahead(bounds, arena(figures(9.5, 0.06)))
    assert [row[2] for row in found] == ["settling time, median", "settling time, 99 %"]
    assert [row[3].endswith("(intervals overlap)") for row in found] == [True, False]
    # A law that settles less often is not ahead by the time of the runs that do.
    assert laws_ahead(bounds, arena(figures(9.5, 0.04, settled=20))) == []
