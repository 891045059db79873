"""Run the commands of tutorials and how-to pages, and compare or update the output that the pages show.

On such a page, a block ``sh`` has commands to run, a block with ``title="NAME"`` is a file that the reader saves, and a
block ``text`` titled ``Output`` is the output of the previous commands. In blocks titled ``Output (your numbers
differ)``, numbers are ignored in the comparison.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

DOCS = Path(__file__).parent
EXACT, VARYING = "Output", "Output (your numbers differ)"
HOME = "~/first"
"""Name of the reader's empty working folder in docs/tutorials/index.md."""
MARKER = "--- end of block ---"
TIMEOUT = 800.0
"""[s] longest time for a page, on a machine that is busy with other work"""
_BLOCK = re.compile(r'^```(?P<language>\w+)(?: title="(?P<title>[^"]+)")?\n(?P<body>.*?)^```$', re.M | re.S)
_NUMBER = re.compile(r"[-+]?\d+(?:[.,]\d+)*(?:e[-+]?\d+)?")


class Block(NamedTuple):
    """A fenced block; ``start`` and ``end`` are the offsets of its body in the text of the page."""

    language: str
    title: str
    body: str
    start: int
    end: int

    @property
    def is_output(self) -> bool:
        """True if the block shows what a command prints."""
        return self.title in (EXACT, VARYING)


def pages() -> list[Path]:
    """Return the pages that show an output."""
    paths = sorted(path for folder in ("tutorials", "how-to") for path in (DOCS / folder).glob("*.md"))
    return [path for path in paths if any(one.is_output for one in blocks(path.read_text()))]


def blocks(text: str) -> list[Block]:
    """Return the fenced blocks of a page in their order."""
    return [Block(one["language"], one["title"] or "", one["body"], *one.span("body")) for one in _BLOCK.finditer(text)]


def run(text: str, folder: Path, **variables: str) -> list[str]:
    """Run a page in an empty folder; return what each ``sh`` block printed.

    Args:
        text: Markdown of the page.
        folder: working directory of the commands.
        variables: environment variables to add to the environment of this process.

    Raises:
        RuntimeError: if a command fails; the text contains stdout and stderr.
    """
    # If a command fails, end the background processes of the page.
    script = ["set -e", "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT"]
    for block in blocks(text):
        if block.language == "sh":
            script += [block.body, f"echo '{MARKER}'"]
        elif block.title and block.language != "text":
            # Quoted, so that the shell does not expand the text.
            script.append(f"cat > {block.title} <<'END OF FILE'\n{block.body}END OF FILE")
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "COLUMNS": "120", **variables}
    command = ["bash", "-c", "\n".join(script)]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=TIMEOUT
    )
    if done.returncode:
        raise RuntimeError(f"status {done.returncode}\n{done.stdout}\n{done.stderr}")
    printed = done.stdout.replace(str(folder.resolve()), HOME)
    return [part.lstrip("\n") for part in printed.split(MARKER + "\n")[:-1]]


def outputs(text: str, printed: list[str]) -> list[tuple[Block, str]]:
    """Return each output block with the output of the previous ``sh`` block."""
    found, remaining, latest = [], iter(printed), ""
    for block in blocks(text):
        if block.language == "sh":
            latest = next(remaining)
        elif block.is_output:
            found.append((block, latest))
    return found


def comparable(text: str, title: str) -> list[str]:
    """Return the lines of an output for a comparison; numbers are masked if they may vary."""
    masked = _NUMBER.sub("#", text) if title == VARYING else text
    return [" ".join(re.sub(r"-{3,}", "---", line).split()) for line in masked.strip().splitlines()]


def fresh(page: Path) -> str:
    """Run a page; return its text with the new output, or an empty string if the page is up to date."""
    text, parts, last, differs = page.read_text(), [], 0, False
    with tempfile.TemporaryDirectory() as folder:
        printed = run(text, Path(folder))
    for block, output in outputs(text, printed):
        differs |= comparable(output, block.title) != comparable(block.body, block.title)
        parts += [text[last : block.start], output]
        last = block.end
    return "".join([*parts, text[last:]]) if differs else ""
