"""The generated parts of docs/ are up to date with the code."""

import importlib.util
import json
import re
from pathlib import Path

import page_tables
import parameter_tables
import pytest

from diffbot_core.schema import parameters_of

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def generate():
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_tables_of_parameters_are_up_to_date():
    for path, text in parameter_tables.pages().items():
        assert path.read_text() == text, path.name


def test_every_parameter_is_in_one_table():
    shown = [one for path in parameter_tables.pages() for one in parameter_tables.shown(path.read_text())]
    known = [(node, one.name) for node, config in parameter_tables.NODES.items() for one in parameters_of(config)]
    assert sorted(shown) == sorted(known)


def test_a_table_of_a_parameter_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="ekf has no parameter gamma"):
        parameter_tables.with_tables("<!-- parameters ekf: filter gamma -->\n<!-- /parameters -->\n")


def test_a_row_shows_default_unit_bound_and_preset():
    page = parameter_tables.with_tables("<!-- parameters controller: k law -->\n<!-- /parameters -->\n")
    ((_, k, law),) = page_tables.tables(page)
    assert k == ["`k`", "4 (paper: 1)", "1/s", ">= 1e-06 and <= 1000", "", "weight of alpha in Omega_G"]
    assert law[:5] == ["`law`", "switching", "-", "", "yes"]


def test_scenario_a_table_is_up_to_date(generate):
    page = (ROOT / "docs/explanation/law/paper.md").read_text()
    assert generate.between_markers(page, "scenario A", generate.scenario_a_table()) == page


def test_results_are_up_to_date(generate):
    pages = generate.results_pages()
    assert len(pages) > 10
    assert [path.name for path, text in pages.items() if path.read_text() != text] == []


def test_every_link_between_pages_has_a_target():
    for page in (ROOT / "docs").rglob("*.md"):
        links = re.findall(r"\]\(([^)#:]+\.(?:md|png|svg|gif|json))(?:#([^)]+))?\)", page.read_text())
        for name, section in links:
            target = page.parent / name
            assert target.is_file(), (page.name, name)
            titles = re.findall(r"^#+ (.*)$", target.read_text(), re.MULTILINE) if section else []
            anchors = {re.sub(r"[^a-z0-9 -]", "", title.lower()).replace(" ", "-") for title in titles}
            assert not section or section in anchors, (page.name, name, section)


def test_every_page_of_the_readme_exists():
    readme = (ROOT / "README.md").read_text()
    targets = [part.split(")")[0] for part in readme.split("](")[1:]]
    assert targets
    missing = [target for target in targets if not (ROOT / target).is_file()]
    assert missing == []


def test_the_answer_on_real_robots_has_the_figures_of_its_tables():
    """The answer is written by hand; its figures are means over the robots, and those of the Labyrinth."""
    results = ROOT / "docs" / "results"
    robots, (labyrinth,) = (
        one["calibrated"] for one in json.loads((results / "data" / "real.json").read_text())["sets"]
    )

    def mean(column, name):
        return sum(one[column][name] for one in robots) / len(robots)

    text = " ".join((results / "real-robots.md").read_text().split("\n## ")[0].split())
    assert f"gives {mean('whole_shipped', 'rmse'):.2f} m RMSE (mean), with a NEES of" in text
    assert f"NEES of {mean('whole_shipped', 'nees'):.1f} where 3 is expected" in text
    assert f"({mean('rest_calibrated', 'rmse'):.3f} m against {mean('rest_shipped', 'rmse'):.3f} m)" in text
    before, after = (labyrinth[column]["rmse"] for column in ("rest_shipped", "rest_calibrated"))
    assert f"it reduces {before:.2f} m to {after:.2f} m" in text


def test_the_answer_on_the_filter_has_the_figures_of_its_tables():
    results = ROOT / "docs" / "results"
    kept = json.loads((results / "data" / "localization.json").read_text())
    cases = {one["name"]: one["filters"][kept["default_filter"]] for one in kept["cases"]}
    text = " ".join((results / "filter" / "index.md").read_text().split("<!--")[0].split())
    for name in ("nominal_10_5", "radius_10_5"):
        assert f"{100.0 * cases[name]['position']['rmse']:.0f} cm (RMSE)" in text
        assert abs(cases[name]["nees"] - 3.0) < 0.2
    assert f"back within {cases['kidnapped_10_5']['back_max']:.1f} s at 5 Hz" in text
