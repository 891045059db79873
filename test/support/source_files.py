"""The files of the source tree, for tests of the project itself."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("diffbot", "diffbot_bag", "diffbot_control", "diffbot_core", "diffbot_lab", "diffbot_sim", "diffbot_tools")
BUILT = {"build", "install", "log", "out", "site", "__pycache__"}
HIDDEN = {".ci", ".github"}
"""Hidden folders that are part of the project."""


def source_tree():
    """Yield the files of the source tree without built and hidden files."""
    for folder, folders, files in os.walk(ROOT):
        folders[:] = [
            name
            for name in folders
            if name in HIDDEN or not (name.startswith(".") or name in BUILT or name.endswith(".egg-info"))
        ]
        yield from (Path(folder, name) for name in files if name != ".git")
