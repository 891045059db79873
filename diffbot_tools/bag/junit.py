"""Results of a check as JUnit XML, which CI servers show rule by rule."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from diffbot_bag.tools.contract_check import Result
from diffbot_core.errors import DiffbotError
from diffbot_core.files import write_text
from diffbot_core.foreign_files import shown


def write_junit(path: Path, bag: str, results: Sequence[Result]) -> None:
    """Write one test case per rule; a failure has the line that the command prints.

    Raises:
        DiffbotError: if the file cannot be written.
    """
    failures = sum(not one.passed for one in results)
    # Printable texts only: XML has no form for control characters.
    suite = ElementTree.Element(
        "testsuite", name=shown(bag), tests=str(len(results)), failures=str(failures), errors="0", skipped="0"
    )
    for one in results:
        case = ElementTree.SubElement(suite, "testcase", classname=one.topic, name=one.rule)
        if not one.passed:
            ElementTree.SubElement(case, "failure", message=one.line())
    text = ElementTree.tostring(suite, encoding="unicode", xml_declaration=True)
    try:
        write_text(path, text + "\n")
    except OSError as error:
        raise DiffbotError(f"cannot write {path}: {error.strerror}") from error
