"""Pages of the site: two screens of text at most, tables that fit, a question first, pictures with text and caption."""

from pathlib import Path

import page_tables
import pytest
import yaml
from prose import alone_standing_pictures, words

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
MAX_WORDS, MAX_ROWS, MAX_COLUMNS = 800, 80, 8
"""Of a page: words of prose, rows of all tables; of a table: columns."""
QUESTIONING = ("explanation/law/", "explanation/filter/", "results/")
"""Where pages begin with their question."""


def pages_of(nav):
    """Return the paths in a navigation of mkdocs, in its order."""
    if isinstance(nav, str):
        return [nav]
    parts = nav.values() if isinstance(nav, dict) else nav
    return [page for part in parts for page in pages_of(part)]


def navigation():
    """Return the pages in mkdocs.yml; its other values are not needed, and their tags unknown."""
    text = (ROOT / "mkdocs.yml").read_text()
    return pages_of(yaml.safe_load(text[text.index("\nnav:") :])["nav"])


PAGES = navigation()


def text_of(page):
    return (DOCS / page).read_text()


def test_every_page_is_in_the_navigation_once():
    assert sorted(PAGES) == sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))


@pytest.mark.parametrize("page", PAGES)
def test_prose_fits_two_screens(page):
    assert len(words(text_of(page))) <= MAX_WORDS


@pytest.mark.parametrize("page", PAGES)
def test_tables_are_neither_wide_nor_endless(page):
    tables = page_tables.tables(text_of(page))
    assert max((len(table[0]) for table in tables), default=0) <= MAX_COLUMNS
    assert sum(len(table) - 1 for table in tables) <= MAX_ROWS


@pytest.mark.parametrize("page", PAGES)
def test_pictures_have_text_and_caption(page):
    assert alone_standing_pictures(text_of(page)) == []


@pytest.mark.parametrize("page", [page for page in PAGES if page.startswith(QUESTIONING)])
def test_a_page_begins_with_its_question(page):
    title, _, question, *_ = text_of(page).splitlines()
    assert title.startswith("# ")
    if not page.endswith("results/index.md"):
        assert question.partition("?")[1], question


@pytest.mark.parametrize("page", [page for page in PAGES if page.startswith("results/")])
def test_a_page_of_results_answers_its_question_in_short(page):
    start = text_of(page).split("\n## ")[0]
    assert page == "results/index.md" or "**In short" in start


def test_words_are_counted_without_tables_code_and_docstrings():
    text = "# A title\n\nTwo [words](x.md).\n\n    code here\n\n| a | b |\n|---|---|\n| 1 | 2 |\n\n"
    text += "```\nfenced\n```\n<!-- mark -->\n::: diffbot_core.geometry\n    options: x\n\nlast"
    assert words(text) == ["#", "A", "title", "Two", "[words].", "last"]
