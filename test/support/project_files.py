"""Which files of the project a program reads: found by running it, from no list of the project's own."""

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

    The project opens modules to hash them: these do not count, nor the metadata, where only the names of laws stand.
    """
    command = [sys.executable, "-c", AUDIT + program]
    # Not in the source tree, which would be found before the installed package.
    result = subprocess.run(command, cwd=tempfile.gettempdir(), check=True, capture_output=True, text=True)
    owned = {str(path) for path in importlib.metadata.files(DISTRIBUTION) or ()}
    paths = (Path(line.removeprefix("read ")) for line in result.stdout.splitlines() if line.startswith("read "))
    inside = {path.relative_to(SITE) for path in paths if path.is_relative_to(SITE)}
    return sorted(path for path in inside if str(path) in owned and not path.parts[0].endswith(".dist-info"))
