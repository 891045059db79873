"""The paper's figures: each shows the runs of its own group, and the command writes all of them."""

import contextlib
import json
from concurrent.futures import Future
from pathlib import Path

import matplotlib.pyplot as plt
from figures import drawn  # noqa: F401 - a fixture

from diffbot_lab.paper import experiment
from diffbot_lab.paper import figures as paper_figures
from diffbot_tools import cli


class Inline:
    """Stands for a pool: the work is done at once."""

    def submit(self, function, *arguments):
        future = Future()
        future.set_result(function(*arguments))
        return future


def test_the_command_draws_all_figures_of_a(tmp_path, monkeypatch):
    monkeypatch.setattr(experiment, "ProcessPoolExecutor", lambda *_, **__: contextlib.nullcontext(Inline()))
    monkeypatch.setattr(paper_figures, "save", lambda figure, *paths: [plt.close(figure), *map(Path.touch, paths)])
    assert cli.main(["experiment", "a", "--runs", "3", "--out", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "a" / "results.json").read_text())["runs"] == 3
    kinds = ("path", "pose", "command") * 2
    stems = [f"figure_{number:02d}_{what}" for number, what in zip(range(4, 10), kinds, strict=True)]
    for setting in ("raw", "ekf", "quiet"):
        found = {path.name for path in (tmp_path / "a" / setting).iterdir()}
        assert found == {f"{stem}.{kind}" for stem in stems for kind in ("png", "svg")}
