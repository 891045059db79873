"""Tests that need more of ROS 2 than the wheels: an overlay or a full installation (docs/how-to/install-on-ros.md)."""

import json
from pathlib import Path

import pytest

FIGURES = pytest.StashKey[dict]()


def pytest_configure(config):
    config.stash[FIGURES] = {}


def pytest_sessionfinish(session):
    """Write the figures if --real-json is given."""
    path = session.config.getoption("--real-json")
    if path and session.config.stash[FIGURES]:
        Path(path).write_text(json.dumps(session.config.stash[FIGURES], indent=1, sort_keys=True) + "\n")


@pytest.fixture
def figures(pytestconfig):
    """Return the measured figures of this run, by their names in docs/results/data/ros.json."""
    return pytestconfig.stash[FIGURES]
