"""The tutorials as programs: ``python docs/tutorial_run.py [NAME ...]`` runs them and writes the outputs they show.

On a page, a block ``sh`` is run, a block with ``title="NAME"`` is a file that the reader saves, and a block ``text``
titled ``Output`` is what the commands before it print. ``Output (your numbers differ)`` is compared without numbers.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

PAGES = Path(__file__).parent / "tutorials"
EXACT, VARYING = "Output", "Output (your numbers differ)"
HOME = "~/first"
"""The empty folder, as docs/tutorials/index.md names it."""
MARKER = "--- end of block ---"
LONGEST = 800.0
"""[s] for a whole page, on a machine that is busy with other work"""
_BLOCK = re.compile(r'^```(?P<language>\w+)(?: title="(?P<title>[^"]+)")?\n(?P<body>.*?)^```$', re.M | re.S)
_NUMBER = re.compile(r"[-+]?\d+(?:[.,]\d+)*(?:e[-+]?\d+)?")


class Block(NamedTuple):
    """A fenced block; ``start`` and ``end`` are the places of its body on the page."""

    language: str
    title: str
    body: str
    start: int
    end: int


def tutorials() -> list[Path]:
    """Return the pages that have something to run."""
    return [page for page in sorted(PAGES.glob("*.md")) if page.name != "index.md"]


def blocks(text: str) -> list[Block]:
    """Return the fenced blocks of a page in their order."""
    return [Block(one["language"], one["title"] or "", one["body"], *one.span("body")) for one in _BLOCK.finditer(text)]


def run(text: str, folder: Path, **variables: str) -> list[str]:
    """Run a page in an empty folder; return what each ``sh`` block printed.

    Args:
        text: of the page.
        folder: where it runs.
        variables: of the environment, beside those of this process.

    Raises:
        RuntimeError: a command failed; the message has its output and its errors.
    """
    # What a failed page leaves running is ended with it.
    script = ["set -e", "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT"]
    for block in blocks(text):
        if block.language == "sh":
            script += [block.body, f"echo '{MARKER}'"]
        elif block.title and block.language != "text":
            # Quoted, so that the shell leaves the text alone.
            script.append(f"cat > {block.title} <<'END OF FILE'\n{block.body}END OF FILE")
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "COLUMNS": "120", **variables}
    command = ["bash", "-c", "\n".join(script)]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=LONGEST
    )
    if done.returncode:
        raise RuntimeError(f"status {done.returncode}\n{done.stdout}\n{done.stderr}")
    printed = done.stdout.replace(str(folder.resolve()), HOME)
    return [part.lstrip("\n") for part in printed.split(MARKER + "\n")[:-1]]


def with_output(text: str, printed: list[str]) -> str:
    """Return a page whose blocks titled Output show what was printed."""
    parts, last = [], 0
    for block, shown in outputs(text, printed):
        parts += [text[last : block.start], shown]
        last = block.end
    return "".join([*parts, text[last:]])


def outputs(text: str, printed: list[str]) -> list[tuple[Block, str]]:
    """Return each block titled Output with what the ``sh`` block before it printed."""
    found, waiting, latest = [], iter(printed), ""
    for block in blocks(text):
        if block.language == "sh":
            latest = next(waiting)
        elif block.title in (EXACT, VARYING):
            found.append((block, latest))
    return found


def comparable(text: str, title: str) -> list[str]:
    """Return the lines of an output as they are compared: without numbers if these vary."""
    masked = _NUMBER.sub("#", text) if title == VARYING else text
    return [" ".join(re.sub(r"-{3,}", "---", line).split()) for line in masked.strip().splitlines()]


def main(names: list[str]) -> None:
    """Run the tutorials, or those of these names, and write their outputs into the pages."""
    for page in tutorials():
        if not names or page.stem in names:
            with tempfile.TemporaryDirectory() as folder:
                text = page.read_text()
                page.write_text(with_output(text, run(text, Path(folder))))
            print(f"{page.name} written", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
