"""Workflows, Dockerfile, CITATION.cff and the pages for contributors name only what is there."""

import re
import shlex
import subprocess
import sys
import xml.etree.ElementTree as ET
from datetime import date
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from source_files import PYTHONS, ROOT

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PAGES = ("CONTRIBUTING.md", "CODE_OF_CONDUCT.md", "SECURITY.md", "examples/README.md")
DOCKERFILE = (ROOT / "Dockerfile").read_text()
FIELDS_OF_CFF = {
    "abstract", "authors", "cff-version", "commit", "contact", "date-released", "doi", "identifiers", "keywords",
    "license", "license-url", "message", "preferred-citation", "references", "repository", "repository-artifact",
    "repository-code", "title", "type", "url", "version",
}  # fmt: skip
"""Of the Citation File Format 1.2.0."""
FIELDS_NEEDED = {"cff-version", "message", "title", "authors", "version", "license", "references"}


def make_targets():
    return set(re.findall(r"^([a-z][a-z-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE))


def called_targets(line):
    """Return the targets of a shell line that calls make; no program's options or comments."""
    words = shlex.split(line, comments=True)
    return {word for word in words[1:] if re.fullmatch("[a-z-]+", word)} if words[:1] == ["make"] else set()


def workflow(path):
    """Parse a workflow; YAML takes the key `on` for true."""
    content = yaml.safe_load(path.read_text())
    content["on"] = content.pop(True)
    return content


def steps_of(content):
    return [step for job in content["jobs"].values() for step in job["steps"]]


def matrix_of(content):
    """Return the Python versions that a workflow names."""
    written = [step["with"]["python-version"] for step in steps_of(content) if "setup-python" in step.get("uses", "")]
    matrices = [job.get("strategy", {}).get("matrix", {}) for job in content["jobs"].values()]
    of_matrices = [version for matrix in matrices for version in matrix.get("python", [])]
    return [version for version in written if "matrix" not in version] + of_matrices


def instructions():
    """Return the instructions of the Dockerfile as pairs of name and arguments, continued lines joined."""
    text = re.sub(r"^\s*#.*\n", "", DOCKERFILE, flags=re.MULTILINE).replace("\\\n", " ")
    return [tuple(line.split(maxsplit=1)) for line in text.splitlines() if line.strip()]


def test_workflows_call_targets_that_exist_on_pythons_that_are_supported():
    called, versions = {}, {}
    for path in WORKFLOWS:
        content = workflow(path)
        assert {"push", "pull_request"} <= set(content["on"])
        assert content["permissions"] == {"contents": "read"}
        assert all("timeout-minutes" in job for job in content["jobs"].values())
        lines = [line for step in steps_of(content) for line in step.get("run", "").splitlines()]
        called[path.stem] = set().union(*map(called_targets, lines))
        versions[path.stem] = matrix_of(content)
    assert called == {"lint": {"lint"}, "site": {"site"}, "test": {"test"}}
    assert set().union(*called.values()) <= make_targets()
    assert versions["test"] == list(PYTHONS)
    assert set(versions["lint"] + versions["site"]) <= set(PYTHONS)
    assert all(isinstance(version, str) for version in versions["test"])  # unquoted, 3.10 is 3.1


def test_contributing_calls_targets_that_exist():
    lines = re.findall(r"^    (make .*)$", (ROOT / "CONTRIBUTING.md").read_text(), re.MULTILINE)
    called = set().union(*map(called_targets, lines))
    assert {"setup", "lint", "test", "test-fast"} <= called <= make_targets()


@pytest.mark.parametrize("name", PAGES)
def test_pages_name_files_that_exist(name):
    """Links, and paths in backquotes: from the root, or a file beside the one named before it."""
    text, here = (ROOT / name).read_text(), (ROOT / name).parent
    assert [link for link in re.findall(r"\]\(([^):]+)\)", text) if not (here / link).exists()] == []
    folder, missing = ROOT, []
    for path in re.findall(r"`([\w./-]+(?:\.\w+|/))`", text):
        place = ROOT / path if "/" in path else folder / path
        folder = place.parent if place.suffix else place
        if "NAME" not in path and not place.exists():
            missing.append(path)
    assert missing == []


def test_hadolint_has_no_complaint():
    done = subprocess.run(
        [Path(sys.executable).with_name("hadolint"), ROOT / "Dockerfile"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "")


def test_dockerfile_copies_what_is_there_and_starts_what_is_installed():
    found = instructions()
    assert found[0] == ("FROM", "ros:jazzy-ros-base")
    copied = [word for name, text in found if name == "COPY" for word in text.split()[:-1]]
    assert copied == ["package.xml", "constraints.txt", "."]
    (entry,) = [yaml.safe_load(text) for name, text in found if name == "ENTRYPOINT"]
    script = ROOT / Path(*entry).relative_to("/ws/src/diffbot")
    assert script.stat().st_mode & 0o111
    assert subprocess.run(["bash", "-n", script], check=False).returncode == 0
    (command,) = [yaml.safe_load(text) for name, text in found if name == "CMD"]
    assert command[:3] == ["ros2", "launch", "diffbot"]
    assert (ROOT / "launch" / command[3]).is_file()


def test_dockerfile_installs_with_pip_what_rosdep_does_not():
    """Names from the constraints by the very expression of the Dockerfile, against the command of the docs."""
    (expression,) = re.findall(r"grep -E '(.*?)' ", DOCKERFILE)
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    installed = {Requirement(line).name for line in lines if re.search(expression, line)}
    page = (ROOT / "docs/how-to/install-on-ros.md").read_text()
    (command,) = re.findall(r"^    pip install --break-system-packages (.*?) +# to run$", page, re.MULTILINE)
    assert installed == {Requirement(word.strip('"')).name for word in command.split()}


def test_citation_is_of_this_version_and_names_the_paper():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert FIELDS_NEEDED <= set(citation) <= FIELDS_OF_CFF
    manifest = ET.parse(ROOT / "package.xml").getroot()
    assert citation["cff-version"] == "1.2.0"
    assert citation["type"] == "software"
    assert (citation["version"], citation["license"]) == (manifest.findtext("version"), manifest.findtext("license"))
    assert citation["authors"] == [{"name": manifest.findtext("maintainer")}]
    (paper,) = citation["references"]
    assert (paper["type"], paper["year"]) == ("conference-paper", 2014)
    assert paper["title"] in " ".join((ROOT / "docs/explanation/law/index.md").read_text().replace("*", "").split())
    assert [author["family-names"] for author in paper["authors"]] == ["Nguyễn", "Phùng", "Trần"]
    assert paper["year"] <= date.today().year
