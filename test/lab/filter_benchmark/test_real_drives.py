"""The benchmark on real drives: each row is the filter's run on that drive, and failures leave nothing behind."""

import json

import pytest
from dataset_files import write_mrclam
from page_tables import assert_shows, tables

from diffbot_lab.filter_benchmark.real_command import run_and_report
from diffbot_tools.dataset.command import import_mrclam
from diffbot_tools.refilter.command import run


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "set"
    write_mrclam(folder, 2, duration=6.0)
    write_mrclam(folder, 4, duration=9.0)
    return folder


@pytest.fixture(scope="module")
def out(data):
    folder = data.parent / "out"
    assert run_and_report(data, folder, True) == 0
    return folder


def test_each_robot_has_a_row_a_figure_and_a_mean(out):
    lines = (out / "table.md").read_text().splitlines()
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| set robot 2, 6 s", "| set robot 4, 9 s", "| mean, 7 s"]
    drives = json.loads((out / "results.json").read_text())["drives"]
    assert [round(one["seconds"]) for one in drives] == [6, 9]
    mean = sum(one["nees"] for one in drives) / 2.0
    assert float(lines[4].split(" | ")[4]) == pytest.approx(mean, abs=0.051)
    assert sorted(path.name for path in out.iterdir()) == [
        "results.json", "set_robot_2.png", "set_robot_4.png", "table.md",
    ]  # fmt: skip


def test_figures_are_those_of_import_and_refilter(data, out, capsys):
    import_mrclam(data, 4, data.parent / "bag")
    capsys.readouterr()
    run(data.parent / "bag", None, data.parent / "again", "/ground_truth", {})
    printed = dict(line.split("  ", 1) for line in capsys.readouterr().out.splitlines() if "  " in line)
    drive = json.loads((out / "results.json").read_text())["drives"][1]
    for name, key in {
        "position, RMSE": "rmse",
        "position, largest": "largest",
        "heading, RMSE": "heading_rmse",
        "NEES, mean": "nees",
        "NIS per number, mean": "nis",
        "whiteness, lag 1": "correlation",
    }.items():
        assert float(printed[name].split()[0]) == pytest.approx(drive[key], abs=6e-4), name


def test_calibration_is_judged_on_what_it_did_not_use(tmp_path, monkeypatch):
    """The rest of a long drive begins at a third of it; the first robot's file is judged on the others alone."""
    monkeypatch.setattr("diffbot_lab.filter_benchmark.real_calibration._SHORT", 30.0)
    folder = tmp_path / "set"
    write_mrclam(folder, 1, duration=42.0)
    write_mrclam(folder, 3, duration=20.0)
    assert run_and_report(folder, tmp_path / "out", False, calibrated=True) == 0
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    rows = results["calibrated"]
    assert [row["calibrated_on"] for row in rows] == ["the first third", "the whole"]
    assert [row["rest_shipped"] == row["whole_shipped"] for row in rows] == [False, True]
    assert [row["whole_with_first"] is None for row in rows] == [True, False]
    for row, whole in zip(rows, results["drives"], strict=True):
        assert row["whole_shipped"] == {name: whole[name] for name in ("rmse", "largest", "nees")}
        assert row["rest_calibrated"] != row["rest_shipped"]
        # The files are without noise.
        assert row["rest_calibrated"]["rmse"] < 0.05
    _, rest, others = tables((tmp_path / "out" / "table.md").read_text())
    mean = 0.5 * (rows[0]["rest_calibrated"]["rmse"] + rows[1]["rest_calibrated"]["rmse"])
    assert_shows([rest[-1][4]], [mean])
    # Of the first robot's file only the other one has figures, so they are also the mean.
    whole, first = (rows[1][column] for column in ("whole_shipped", "whole_with_first"))
    assert [row[0] for row in others[1:]] == [rows[1]["name"], "mean"]
    for row in others[1:]:
        assert_shows(row[1:], [whole["rmse"], whole["nees"], first["rmse"], first["nees"]])
