"""Campaigns are read from YAML and flags and expanded into cells; errors are one line that names the value."""

import itertools
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import yaml

from diffbot_control.law import PRESETS
from diffbot_lab.campaign.spec import hash_of_values, make_campaign, read_campaign
from diffbot_sim.robot_step import FEEDBACKS
from diffbot_tools import cli

ROOT = Path(__file__).resolve().parents[3]
CIRCLE = {"circle": {"radius": 2.0, "points": 4, "headings": [0.5, -1.0]}}


def test_the_example_is_expanded_into_cells():
    campaign = read_campaign(ROOT / "config" / "campaign.yaml", {})
    grid = yaml.safe_load((ROOT / "config" / "campaign.yaml").read_text())["grid"]
    points = list(itertools.product(grid["k"], grid["eps_P"]))
    controllers = [cell.case.controller for cell in campaign.cells]
    assert [(one.gains.k, one.eps_P) for one in controllers] == points
    assert {one.eps_P_leave for one in controllers} == {0.6}
    case = campaign.cells[0].case
    assert (case.steps, case.feedback, case.xy_tolerance, case.yaw_tolerance) == (400, FEEDBACKS.index("ekf"), 0.4, 0.1)


def test_starts_from_box_list_and_circle():
    box = make_campaign({"start": {"box": {"x": [-1, 3], "heading": [0.5, 0.5]}}}).starts
    assert box.poses.tolist() == [[1.0, 0.0, 0.5]]
    assert box.half == (2.0, 0.0, 0.0)
    rows = [[1, 2, 3.0], [4.0, 5, -1]]
    assert make_campaign({"start": {"list": rows}}).starts.poses.tolist() == rows
    circle = make_campaign({"start": CIRCLE}).starts.poses
    expected = [(x, y, heading) for heading in (0.5, -1.0) for x, y in ((2, 0), (0, 2), (-2, 0), (0, -2))]
    assert circle == pytest.approx(np.array(expected), abs=1e-12)


def test_flags_take_precedence_and_grids_are_merged_by_name(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(
        "runs: 5\nseed: 3\nset: {preset: paper, h: 0.2, k_2: 2.0}\ngrid: {k: [1.0, 2.0], eps_P: [0.1, 0.2]}\n"
    )
    campaign = read_campaign(path, {"runs": 7, "set": {"h": 0.3}, "grid": {"k": [4]}})
    assert (campaign.options.runs, campaign.options.seed) == (7, 3)
    assert [cell.values for cell in campaign.cells] == [{"k": 4, "eps_P": 0.1}, {"k": 4, "eps_P": 0.2}]
    gains = campaign.cells[0].case.controller.gains
    assert (gains.h, gains.k_2, gains.k) == (0.3, 2.0, 4.0)
    assert isinstance(gains.k, float)  # an int would be compiled again
    campaign = make_campaign({"duration": 3.0, "grid": {"sampling_time": [0.1, 0.25, 10.0]}})
    assert [cell.case.steps for cell in campaign.cells] == [30, 12, 1]


def test_the_identity_depends_on_every_value_that_changes_results():
    paper = {"preset": "paper", "h": 0.2}
    base = {"runs": 5, "set": paper, "grid": {"k": [1.0]}, "start": CIRCLE}
    found = make_campaign(base)
    # Order and explicit defaults do not matter.
    for same in (dict(reversed(base.items())), {**base, "set": {**paper, "k_2": 2.7}}):
        assert make_campaign(same).identity == found.identity
    others = [{"runs": 6}, {"seed": 2}, {"duration": 61.0}, {"feedback": "raw"}]
    others += [{"set": {"preset": "precise"}, "grid": {}}, {"set": {**paper, "gate_probability": 0.98}}]
    others += [{"set": {**paper, "h": 0.20000000000000004}}, {"grid": {"k": [1.5]}}]
    others += [{"start": {"circle": {"radius": 2.5}}}]
    campaigns = [found, *(make_campaign({**base, **other}) for other in others)]
    assert len({one.identity for one in campaigns}) == len(campaigns)


REFUSED = {
    "unknown key": ("rnus: 5", "did you mean runs"),
    "empty grid": ("grid: {k: []}", "grid.k = []"),
    "the same value twice": ("grid: {k: [1, 2, 1.0]}", "grid.k = [1, 2, 1.0]"),
    "the same preset twice": ("grid: {preset: [tuned, tuned]}", "each value may be given only once"),
    "a list of presets": ("set: {preset: [tuned]}", "preset = ['tuned']: must be a known name (paper, precise, tuned)"),
    "too many cells": (f"grid: {{k: {list(range(1, 102))}, h: {list(range(1, 102))}}}", "10201 cells"),
    "delay": ("set: {fix_delay: 1.2}", "fix_delay = 1.2"),
    "two starts": ("start: {list: [[0, 0, 0]], box: {}}", "start = {"),
    "too large for a float": (f"start: {{list: [[0, 0, 1{'0' * 400}]]}}", "<a number of 1329 bits>"),
    "box turned round": ("start: {box: {x: [1, 0]}}", "start.box.x = [1, 0]"),
    "circle of nan headings": ("start: {circle: {radius: 1, headings: [.nan]}}", "start.circle.headings = [nan]"),
    "of another law in a cell": ("set: {sigma_known: 0.1}\ngrid: {preset: [tuned, paper]}", "sigma_known = 0.1"),
    "of the filter, without a filter": (
        "feedback: raw\nset: {gate_probability: 0.9}",
        "has an effect only with feedback: ekf",
    ),
    "not a mapping": ("- 1\n- 2", "must contain a mapping of keys, but it contains a list"),
    "fixes for the true pose": ("feedback: truth\nset: {fix_rate: 1.0}", "feedback: ekf or raw"),
}


def assert_one_line(text, part):
    assert part in text
    assert "\n" not in text.strip()
    assert "Traceback" not in text
    assert len(text) < 2500


@pytest.mark.parametrize("name", REFUSED)
def test_a_wrong_file_is_refused_in_one_line(name, tmp_path, capsys):
    text, part = REFUSED[name]
    path = tmp_path / "c.yaml"
    path.write_text(text)
    out = tmp_path / "out"
    assert cli.main(["campaign", str(path), "--out", str(out)]) == 1
    assert_one_line(capsys.readouterr().err, part)
    assert not out.exists()


@pytest.mark.parametrize(
    ("flags", "status", "part"),
    [
        (["--grid", "k"], 2, "NAME=VALUE"),
        (["--set", "k=1", "k=2"], 1, "--set k = 2: must be given once"),
        (["--set", "k=1", "--grid", "k=[1]"], 1, "set.k = 1"),
        (["--workers", "2", "--scheduler", "tcp://127.0.0.1:1"], 2, "--scheduler: not allowed with argument --workers"),
    ],
)
def test_wrong_flags_are_refused_in_one_line(flags, status, part, tmp_path, capsys):
    try:
        found = cli.main(["campaign", "--out", str(tmp_path / "out"), *flags])
    except SystemExit as end:
        found = end.code
    assert found == status
    assert_one_line(capsys.readouterr().err.strip().splitlines()[-1], part)
    assert not (tmp_path / "out").exists()


def test_a_campaign_runs_any_law():
    given = {"set": {"k_phi": 2.0, "wheel_radius": 0.07}, "grid": {"k_delta": [1.5, 2.0]}}
    campaign = make_campaign({"law": "graceful", **given})
    configs = [cell.case.controller for cell in campaign.cells]
    assert [(one.k_phi, one.k_delta) for one in configs] == [(2.0, 1.5), (2.0, 2.0)]
    assert {one.data_sheet.wheels.wheel_radius for one in configs} == {0.07}
    assert {cell.case.robot.plant.wheels.wheel_radius for cell in campaign.cells} == {0.07}
    by_path = make_campaign({"law": "diffbot_lab.laws.graceful:Graceful", **given})
    assert by_path.cells[0].case == campaign.cells[0].case
    assert by_path.identity != campaign.identity


def test_a_preset_selects_its_law_in_each_cell_and_the_default_preset_is_the_nodes():
    cells = make_campaign({"grid": {"preset": ["paper", "tuned", "precise"]}}).cells
    assert [cell.law for cell in cells] == ["paper", "switching", "switching"]
    assert [cell.case.controller for cell in cells] == [PRESETS[name].config for name in ("paper", "tuned", "precise")]
    assert make_campaign({}).cells[0].case.controller == PRESETS["tuned"].config


class Pair(NamedTuple):
    k: float
    h: float


class Other(NamedTuple):
    k: float
    h: float


def test_the_hash_depends_on_type_field_and_last_bit_of_each_value():
    values = [
        Pair(1.0, 2.0),
        Pair(2.0, 1.0),
        Pair(1.0, math.nextafter(2.0, 3.0)),
        Other(1.0, 2.0),
        {"k": 1.0, "h": 2.0},
        np.array([[1.0, 2.0]]),
        np.array([1.0, math.inf]),
        *([1.0, other] for other in (2.0, None, True, 1, "1")),
        (Pair(1.0, 2.0), Pair(1.0, 2.0)),
    ]
    assert len({hash_of_values([value]) for value in values}) == len(values)
    assert hash_of_values(values) != hash_of_values(values[::-1])
    assert hash_of_values([np.array([1.0, 2.0])]) == hash_of_values([(1.0, 2.0)])
    assert hash_of_values([{"h": 2.0, "k": 1.0}]) == hash_of_values([{"k": 1.0, "h": 2.0}])
