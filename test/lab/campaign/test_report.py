"""The files of a campaign agree with each other, and its heat maps show each cell."""

import csv
import itertools
import json

import matplotlib.image
import numpy as np
import pytest

from diffbot_control.law.registry import resolve_law
from diffbot_lab.campaign.report import table, write_report
from diffbot_lab.campaign.spec import code_version, make_campaign
from diffbot_lab.campaign.statistics import CellStatistics, count_outcomes
from diffbot_sim.batch import COLUMNS, run_batch

BASE = {"runs": 5, "duration": 15.0, "feedback": "raw", "start": {"box": {"x": [-2.0, 2.0], "y": [-2.0, 2.0]}}}
BASE["set"] = {"preset": "paper"}
GRID = {"k": [1.0, 4.0], "eps_P": [0.05, 0.2, 0.5]}


def make(grid, **changes):
    campaign = make_campaign({**BASE, "grid": grid, **changes})
    statistics = []
    for cell in campaign.cells:
        outcomes = run_batch(cell.case, campaign.starts, 1, 0, campaign.options.runs, law=resolve_law(cell.law))
        statistics.append(CellStatistics())
        statistics[-1].add(count_outcomes(outcomes))
    return campaign, statistics


def test_all_files_have_the_same_content(tmp_path):
    campaign, statistics = make(GRID)
    paths = write_report(campaign, statistics, tmp_path)
    assert {path.name for path in paths} == {path.name for path in tmp_path.iterdir()}
    content = json.loads((tmp_path / "results.json").read_text(), parse_constant=pytest.fail)  # JSON has no infinity
    made_by = {"identity": campaign.identity, "sources": code_version()}
    assert {name: content[name] for name in made_by} == made_by
    cells = content["cells"]
    points = [dict(zip(GRID, values, strict=True)) for values in itertools.product(*GRID.values())]
    assert [{name: cell[name] for name in GRID} for cell in cells] == points
    for cell, one in zip(cells, statistics, strict=True):
        assert {name: value for name, value in cell.items() if name not in GRID} == one.summary()

    with (tmp_path / "results.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    for line, cell in zip(lines, cells, strict=True):
        assert list(line) == list(cell)
        for key, value in cell.items():
            assert line[key] == "" if value is None else float(line[key]) == value


@pytest.mark.parametrize("grid", [GRID, {"k": [1.0, 4.0]}])
def test_the_heat_map_shows_each_cell_in_its_place(grid, tmp_path, monkeypatch):
    shown = []
    monkeypatch.setattr("diffbot_lab.campaign.report._draw_heat_map", lambda *arguments: shown.append(arguments))
    campaign, statistics = make(grid)
    write_report(campaign, statistics, tmp_path)
    for metric, (values, across, down, *_) in zip(("success_rate", "settling_time_q50"), shown, strict=True):
        assert across == ("k", [1.0, 4.0])
        assert down == (("eps_P", GRID["eps_P"]) if "eps_P" in grid else ("", [""]))
        expected = [one.summary()[metric] for one in statistics]
        assert values.T.ravel() == pytest.approx([np.nan if one is None else one for one in expected], nan_ok=True)


def test_the_table_shows_whole_names_and_values_in_columns():
    grid = {"filter": ["ekf", "ekf_fnn_calibrating"], "command_latency": [0.0, 0.3]}
    one = CellStatistics()
    one.add(count_outcomes(np.zeros((1, len(COLUMNS)))))
    _, head, line, *rows = table(make_campaign({"grid": grid}), [one] * 4).splitlines()
    assert head.split()[:2] == list(grid)
    assert [tuple(row.split()[:2]) for row in rows] == [
        (name, f"{value}") for name, value in itertools.product(*grid.values())
    ]
    assert {len(row) for row in rows} == {len(head)} == {len(line)}


def test_a_large_grid_without_settled_runs_is_drawn(tmp_path):
    # With a single step, no run settles.
    grid = {"k": [1.0, 2.0], "h": [0.1 + 0.01 * number for number in range(31)]}
    campaign, statistics = make(grid, runs=1, duration=0.1, start={"list": [[1e6, -1e6, 0.0]]})
    for path in write_report(campaign, statistics, tmp_path):
        if path.suffix == ".png":
            assert 200 < max(matplotlib.image.imread(path).shape) < 4000
    cells = json.loads((tmp_path / "results.json").read_text(), parse_constant=pytest.fail)["cells"]
    assert {(cell["success_rate"], cell["settling_time_q50"]) for cell in cells} == {(0.0, None)}
    heading, *_, last = table(campaign, statistics).splitlines()
    assert heading == "law switching, preset paper; feedback raw; 0.1 s; seed 1; not the default: nothing"
    assert last == "... and 22 more cells in results.csv"
