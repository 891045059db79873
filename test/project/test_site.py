"""The site: it builds strictly, loads nothing from elsewhere and is readable; its tutorials print what they show."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
import tutorial_run
from prose import sentences

from diffbot_control.law.presets import PRESETS

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
LESSONS = [*sorted(DOCS.glob("tutorials/*.md")), *sorted(DOCS.glob("how-to/*.md"))]
LONGEST_SENTENCE = 30


def name(page):
    """Return the path of a page below docs/, for the name of a test."""
    return str(page.relative_to(DOCS).with_suffix(""))


class Loaded(HTMLParser):
    """Collects what a page loads, and its pictures without a text."""

    def __init__(self):
        super().__init__()
        self.addresses, self.silent = [], []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if tag in ("script", "img", "iframe", "source") or (tag == "link" and given.get("rel") != "canonical"):
            self.addresses.append(given.get("src") or given.get("href") or "")
        if tag == "img" and not given.get("alt", "").strip():
            self.silent.append(given.get("src"))


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built as ``make site`` does."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, env=quiet, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return folder


def test_every_page_is_built_and_loads_nothing_from_other_hosts(site):
    built = {str(path.relative_to(site).with_suffix(".md")): path for path in site.rglob("*.html")}
    assert {str(page.relative_to(DOCS)) for page in PAGES} == set(built) - {"404.md"}
    for path in built.values():
        page = Loaded()
        page.feed(path.read_text())
        assert [one for one in page.addresses if re.match(r"(?:\w+:)?//", one)] == [], path.name
        assert page.silent == [], path.name


def test_python_api_shows_the_docstrings(site):
    text = re.sub(r"<[^>]+>", "", (site / "reference" / "python.html").read_text())
    assert "the next memory, the command, and what the step worked with" in text
    assert not re.search(r":(?:class|func|meth|mod|data):", text)
    assert "Initialise the filter, and wait until it publishes a pose within 1 m of that." in text


def test_a_broken_anchor_fails_the_build(tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("# A\n\n[b](#b)\n")
    settings = (ROOT / "mkdocs.yml").read_text()
    validation = re.search(r"^validation:\n(?:  .*\n)+", settings, re.MULTILINE)[0]
    (tmp_path / "mkdocs.yml").write_text(f"site_name: a\n{validation}")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict"]
    built = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert built.returncode == 1
    assert "#b" in built.stderr


@pytest.mark.parametrize("page", LESSONS, ids=name)
def test_no_sentence_of_a_lesson_is_long(page):
    long = [one for one in sentences(page.read_text()) if len(one.split()) > LONGEST_SENTENCE]
    assert long == []


@pytest.mark.graph
@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", tutorial_run.tutorials(), ids=lambda page: page.stem)
def test_a_tutorial_prints_what_it_shows(page, tmp_path):
    text = page.read_text()
    printed = tutorial_run.run(text, tmp_path)
    shown = tutorial_run.outputs(text, printed)
    assert shown
    for block, output in shown:
        comparable = tutorial_run.comparable
        assert comparable(output, block.title) == comparable(block.body, block.title)


def test_exact_outputs_are_compared_with_their_numbers():
    comparable, exact, varying = tutorial_run.comparable, tutorial_run.EXACT, tutorial_run.VARYING
    assert comparable("a 1.0\n", exact) != comparable("a 2.0", exact)
    assert comparable("a 1\n", varying) == comparable("a 2e-3", varying)
    assert comparable("a 1", varying) != comparable("b 1", varying)


def test_presets_on_the_pages_exist():
    named = {name for page in PAGES for name in re.findall(r"preset(?::=?| )(\w+)", page.read_text())}
    assert {"paper"} <= named & set(PRESETS)
