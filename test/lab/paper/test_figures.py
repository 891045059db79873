"""The paper's figures: each shows the runs of its own group, and the command writes all of them."""

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import matplotlib.pyplot as plt

from diffbot_lab.paper import experiment
from diffbot_lab.paper import figures as paper_figures
from diffbot_tools import cli


def test_the_command_draws_all_figures_of_a(tmp_path, monkeypatch):
    monkeypatch.setattr(experiment, "ProcessPoolExecutor", lambda *_, **__: ThreadPoolExecutor(1))
    monkeypatch.setattr(paper_figures, "save", lambda figure, *paths: [plt.close(figure), *map(Path.touch, paths)])
    assert cli.main(["experiment", "a", "--runs", "3", "--out", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "a" / "results.json").read_text())["runs"] == 3
    kinds = ("path", "pose", "command") * 2
    stems = [f"figure_{number:02d}_{what}" for number, what in zip(range(4, 10), kinds, strict=True)]
    for setting in ("raw", "ekf", "quiet"):
        found = {path.name for path in (tmp_path / "a" / setting).iterdir()}
        assert found == {f"{stem}.{kind}" for stem in stems for kind in ("png", "svg")}
