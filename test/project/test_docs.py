"""The generated parts of docs/ are up to date with the code."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def generate():
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_parameters_page_is_up_to_date(generate):
    assert (ROOT / "docs" / "parameters.md").read_text() == generate.parameters_page()


def test_scenario_a_table_is_up_to_date(generate):
    page = (ROOT / "docs/explanation/law/paper.md").read_text()
    assert generate.between_markers(page, "scenario A", generate.scenario_a_table()) == page


def test_localization_page_is_up_to_date(generate):
    assert (ROOT / "docs" / "localization.md").read_text() == generate.localization_page()


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
