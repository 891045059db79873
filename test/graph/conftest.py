"""Fixtures of the tests of the graph."""

import fcntl
import importlib
import sys

import pytest


@pytest.fixture
def nodes():
    """A context for each test: what a node has published stays listed as long as an executor holds its handles."""
    import one_process

    with one_process.nodes() as running:
        yield running


@pytest.fixture(scope="session")
def nav2_folder(tmp_path_factory, worker_id):
    """Return the folder that holds the package nav2_msgs; this process can import it, too."""
    from diffbot_tools.interfaces.build import build_interfaces

    base = tmp_path_factory.getbasetemp()
    base = base if worker_id == "master" else base.parent
    folder = base / "interfaces"
    with (base / "interfaces.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "nav2_msgs").is_dir():
            build_interfaces(folder)
    sys.path.append(str(folder))
    importlib.invalidate_caches()
    return folder
