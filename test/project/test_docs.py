"""The documentation: generated parts are up to date, links have targets, and tutorials print the output shown."""

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from operator import attrgetter
from pathlib import Path

import build
import graph
import parameter_tables
import pytest
import tutorial_run

from diffbot_bag.messages import make
from diffbot_core.schema import parameters_of

ROOT = Path(__file__).parents[2]
FIRST_DRIVE = "first-drive"
"""test/tools/test_demo.py runs this tutorial and compares its output"""
TUTORIALS = {page.stem: page.read_text() for page in tutorial_run.pages() if page.stem != FIRST_DRIVE}


def test_generated_parts_of_the_reference_are_up_to_date():
    pages = build.tables()
    assert [path.name for path, text in pages.items() if path.read_text() != text] == []
    assert build.rules() in pages[build.DOCS / "reference" / "bag-check.md"]


def test_the_reference_shows_each_parameter_once():
    shown = [one for text in build.tables().values() for one in parameter_tables.shown(text)]
    known = [(node, one.name) for node, config in parameter_tables.NODES.items() for one in parameters_of(config)]
    assert sorted(shown) == sorted(known)


@pytest.mark.install
def test_the_site_builds_strictly(tmp_path):
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
    """Return the anchors of a page as mkdocs and GitHub name them: one for each heading, and "" for the page."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE) if page.suffix == ".md" else []
    return {"", *(re.sub(r"[^\w\- ]", "", one).lower().replace(" ", "-") for one in headings)}


@pytest.mark.parametrize("kind", ["Twist", "TwistStamped"])
def test_the_layout_for_foxglove_plots_the_commands_of_either_type(kind):
    message, found = make(f"geometry_msgs/msg/{kind}"), 0
    for path in re.findall(r'"/cmd_vel\.([a-z.]+)"', (ROOT / "config/foxglove.json").read_text()):
        with suppress(AttributeError):
            found += isinstance(attrgetter(path)(message), float)
    assert found == 2


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """Run the tutorials in parallel; return a future with the output of each."""
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
def test_a_tutorial_prints_the_output_that_it_shows(name, printed):
    shown = tutorial_run.outputs(TUTORIALS[name], printed[name].result())
    assert shown
    for block, output in shown:
        printed_lines, lines = (tutorial_run.comparable(text, block.title) for text in (output, block.body))
        # On a busy machine, some of the feedback is missing.
        assert set(printed_lines) <= set(lines)
        assert [one for one in printed_lines if " to go" not in one] == [one for one in lines if " to go" not in one]
