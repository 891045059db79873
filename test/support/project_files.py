"""Finds the files of the project that a program reads, by running it."""

import importlib.metadata
import subprocess
import sys
import tempfile
from pathlib import Path

import diffbot_core
from diffbot_core.installed import DISTRIBUTION

SITE = Path(diffbot_core.__file__).parents[1]
AUDIT = """
import atexit, sys
read = []
sys.addaudithook(lambda event, given: read.append(given[0]) if event == "open" else None)
@atexit.register
def tell():
    modules = [getattr(module, "__file__", None) for module in sys.modules.values()]
    others = [str(one) for one in read if not str(one).endswith((".py", ".pyc"))]
    for one in sorted({one for one in [*others, *modules] if one}):
        print("read", one)
"""


def files_read_by(program):
    """Return the project's installed files that a Python program imports, and others that it opens.

    Modules that the project opens to hash them are not included, nor is the metadata, which contains the names of laws.
    """
    command = [sys.executable, "-c", AUDIT + program]
    # In the source tree, Python would import the source instead of the installed package.
    result = subprocess.run(command, cwd=tempfile.gettempdir(), check=True, capture_output=True, text=True)
    owned = {str(path) for path in importlib.metadata.files(DISTRIBUTION) or ()}
    paths = (Path(line.removeprefix("read ")) for line in result.stdout.splitlines() if line.startswith("read "))
    inside = {path.relative_to(SITE) for path in paths if path.is_relative_to(SITE)}
    return sorted(path for path in inside if str(path) in owned and not path.parts[0].endswith(".dist-info"))
