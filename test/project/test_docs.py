"""The generated parts of docs/ are up to date with the code."""

import importlib.util
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
    page = (ROOT / "docs" / "control.md").read_text()
    assert generate.between_markers(page, "scenario A", generate.scenario_a_table()) == page


def test_localization_results_are_up_to_date(generate):
    page = ROOT / "docs" / "localization-results.md"
    assert page.read_text() == generate.localization_results_page()


def test_every_link_between_pages_has_a_target():
    for page in (ROOT / "docs").rglob("*.md"):
        links = re.findall(r"\]\(([^)#:]+\.(?:md|png|svg|gif))(?:#([^)]+))?\)", page.read_text())
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
