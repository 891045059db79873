"""The documentation: generated parts follow the code, links have targets, tutorials print what they show."""

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import build
import graph
import parameter_tables
import pytest
import tutorial_run

from diffbot_core.schema import parameters_of

ROOT = Path(__file__).parents[2]
FIRST_DRIVE = "first-drive"
"""its results are compared in test/tools/test_demo.py, which runs it"""
TUTORIALS = {page.stem: page.read_text() for page in tutorial_run.pages() if page.stem != FIRST_DRIVE}


def test_lists_of_parameters_and_rules_are_up_to_date():
    pages = build.tables()
    assert [path.name for path, text in pages.items() if path.read_text() != text] == []
    assert build.rules() in pages[build.DOCS / "reference" / "bag-check.md"]


def test_the_reference_shows_each_parameter_once():
    shown = [one for text in build.tables().values() for one in parameter_tables.shown(text)]
    known = [(node, one.name) for node, config in parameter_tables.NODES.items() for one in parameters_of(config)]
    assert sorted(shown) == sorted(known)


@pytest.mark.install
def test_the_site_builds_strictly(tmp_path):
    """A broken link or anchor, or a page outside the navigation, is an error."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, env=quiet, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "SECURITY.md"])
def test_every_link_of_a_page_outside_the_site_has_a_target(name):
    links = re.findall(r"\]\(([^)#:]+)(?:#([^)]+))?\)", (ROOT / name).read_text())
    assert links
    assert [path for path, anchor in links if not (ROOT / path).is_file() or anchor not in anchors(ROOT / path)] == []


def anchors(page):
    """The anchors of a page, as mkdocs and GitHub name them: one for each heading, and none for the page itself."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE) if page.suffix == ".md" else []
    return {"", *(re.sub(r"[^\w\- ]", "", one).lower().replace(" ", "-") for one in headings)}


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """Run tutorials beside each other, since those with a robot mostly wait; return what each will have printed."""
    with ExitStack() as domains, ThreadPoolExecutor(3) as pool:
        yield {
            name: pool.submit(
                tutorial_run.run,
                text,
                tmp_path_factory.mktemp(name),
                ROS_DOMAIN_ID=str(domains.enter_context(graph.private_domain())),
            )
            for name, text in TUTORIALS.items()
        }


@pytest.mark.graph
@pytest.mark.study
@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_prints_what_it_shows(name, printed):
    shown = tutorial_run.outputs(TUTORIALS[name], printed[name].result())
    assert shown
    for block, output in shown:
        printed_lines, lines = (tutorial_run.comparable(text, block.title) for text in (output, block.body))
        # A program that is held up misses some of the feedback.
        assert set(printed_lines) <= set(lines)
        assert [one for one in printed_lines if " to go" not in one] == [one for one in lines if " to go" not in one]
