"""Nav2's actions for the tests: built once a run into its temporary folder, and put onto the path of who needs them."""

import fcntl
import importlib
import sys

import graph
import pytest

from diffbot_tools.interfaces.build import build_interfaces


@pytest.fixture(scope="session")
def nav2_folder(tmp_path_factory, worker_id):
    """Return the folder that holds the package nav2_msgs; this process can import it, too."""
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


def nav2_environment(folder, **changes):
    """Return the environment of a process that finds nav2_msgs."""
    environment = graph.environment(**changes)
    environment["PYTHONPATH"] += f":{folder}"
    return environment
