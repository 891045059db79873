"""Finds the test files that an installation can run: a ROS workspace may lack extras and the pinned packages."""

import ast
import importlib.metadata
import importlib.util
import os
import shutil
from collections import Counter
from functools import cache
from pathlib import Path

TESTS = Path(__file__).resolve().parent.parent
ROOT = TESTS.parent
PACKAGES = {
    "distributed": "distributed",
    "evo": "evo",
    "flint": "python-flint",
    "gymnasium": "gymnasium",
    "hypothesis": "hypothesis",
    "mcap_ros2": "mcap-ros2-support",
    "nbformat": "nbformat",
    "numba": "numba",
    "packaging": "packaging",
    "pandas": "pandas",
    "playwright": "playwright",
    "rosbags": "rosbags",
    "websockets": "websockets",
}
"""Packages of pip that tests need beyond package.xml, by the name of the module."""
WHEELS = "ros-jazzy-rclpy"
BROWSER = "chromium"
BROWSERS = (BROWSER, "chromium-browser", "google-chrome")
"""Installed browsers that playwright can use."""
PINNED_SET = "project"
"""Folder of the tests of the environment of `make setup`: pins, tools, colcon and pip."""
TRANSFORMS = "tf2_ros"
"""Module that only a ROS installation or an overlay on the wheels contains."""
INSTALLED = "real"
"""Folder of the tests that need a ROS installation or an overlay (`make real`)."""
AMCL = "nav2_amcl"
"""ROS package of test_amcl.py, which an overlay or installation may lack."""
AT_RUN_TIME = {
    "diffbot_tools.calibration.kernel": {"numba"},
    "diffbot_sim.jit": {"numba"},
    "test.core.test_schema": {"numba"},
    "test.lab.campaign.test_runner": {"distributed"},
    "test.tools.view.test_live_page": {"playwright"},
    "test.tools.view.test_map_marks": {"playwright"},
}
"""Packages that modules import in a function, by a string, or in a program that they start."""


def missing_packages():
    """Return pip's names of the packages that are not installed."""
    missing = {pip for name, pip in PACKAGES.items() if importlib.util.find_spec(name) is None}
    if browser() is None:
        missing.add(BROWSER)
    if importlib.util.find_spec(TRANSFORMS) is None:
        missing.add(TRANSFORMS)
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    if not any((Path(prefix) / "share" / AMCL).is_dir() for prefix in prefixes):
        missing.add(AMCL)
    return missing if any(importlib.metadata.distributions(name=WHEELS)) else {*missing, WHEELS}


def browser():
    """Return the path of an installed browser, or None."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def left_out(missing):
    """Return the missing packages of each test file that needs any of them, by its path relative to test/."""
    if not missing:
        return {}
    # Reading the imports of all files takes seconds in each worker, so only if one of these packages is missing.
    by_imports = missing & {*PACKAGES.values(), BROWSER}
    lacking = {}
    for path in sorted(TESTS.rglob("test_*.py")):
        name = str(path.relative_to(TESTS))
        needed = {PACKAGES[one] for one in needs_of(path)} if by_imports else set()
        needed |= {WHEELS} if path.parent.name == PINNED_SET else set()
        needed |= {BROWSER} if "playwright" in needed else set()
        needed |= {TRANSFORMS} if path.parent.name == INSTALLED else set()
        needed |= {AMCL} if path.name == "test_amcl.py" else set()
        if needed & missing:
            lacking[name] = needed & missing
    return lacking


def summary(lacking):
    """Return the line for the report of pytest; empty if all files can run."""
    if not lacking:
        return ""
    counts = Counter(package for packages in lacking.values() for package in packages)
    named = ", ".join(f"{package} ({count})" for package, count in sorted(counts.items()))
    return f"{len(lacking)} test files are left out, since packages that they need are not installed: {named}"


@cache
def needs_of(path):
    """Return the names in PACKAGES that a file imports, directly or through modules of this project."""
    names, modules = set(), [path]
    visited = set()
    while modules:
        module = modules.pop()
        if module in visited:
            continue
        visited.add(module)
        imported = _imports(module, everywhere=module.is_relative_to(TESTS))
        names |= {name.partition(".")[0] for name in imported}
        names |= AT_RUN_TIME.get(".".join(module.relative_to(ROOT).with_suffix("").parts), set())
        modules += [found for name in imported for found in _files_of(name)]
    return names & set(PACKAGES)


@cache
def _imports(path, everywhere):
    """Return the dotted names that a file imports, with ``everywhere`` also in functions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names = set()
    for node in ast.walk(tree) if everywhere else tree.body:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def _files_of(name):
    """Return the files of this project that an import of ``name`` runs."""
    place = Path(*name.split("."))
    bases = [ROOT] if name.startswith("diffbot_") else [TESTS / "support"]
    files = [base / place.with_suffix(".py") for base in bases]
    return [file for file in files if file.is_file()]
