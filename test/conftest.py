"""Surroundings of all tests, set before anything of ROS is imported: each pytest worker has a graph of its own."""

import os
import signal
import sys
from pathlib import Path

import graph
import pytest
import requirements

from diffbot_tools.processes import localhost_discovery

try:
    from hypothesis import settings
except ImportError:
    # The tests that need it are left out (requirements.py).
    pass
else:
    # The same examples in every run; --hypothesis-profile=explore looks for new ones.
    settings.register_profile("repeatable", derandomize=True, deadline=None)
    settings.register_profile("explore", derandomize=False, deadline=None)
    settings.load_profile("repeatable")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Started in the background of a shell; processes that the tests start would ignore SIGINT, too.
    signal.signal(signal.SIGINT, signal.default_int_handler)
# Files of a node that others could write to are not used, and tests write some.
os.umask(0o022)
# Wrong types in a message field raise instead of being sent.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ |= localhost_discovery()
os.environ["ROS_DOMAIN_ID"] = str(graph.free_domain())
# With wheels the packages stand in the environment itself; another installation's must not be found before them, but
# those of an overlay on this environment may (`make real`).
_PREFIXES = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
if (Path(sys.prefix) / "share" / "std_msgs").is_dir() and sys.prefix not in _PREFIXES:
    os.environ.pop("AMENT_PREFIX_PATH", None)

TESTS = Path(__file__).parent
LEFT_OUT = requirements.left_out(requirements.missing_packages())
collect_ignore = list(LEFT_OUT)
PROCESSES = ("graph/", "faults/", "real/", "slow/")
LONGEST_FIRST = ("install", "study", "graph")
"""Marks, by the time that a file of such tests takes."""
STUDIES = (
    "lab/benchmark/",
    "lab/campaign/",
    "lab/test_filter_benchmark.py",
    "lab/test_paper.py",
    "lab/stability/",
    "sim/compiled/",
    "tools/calibration/",
)


@pytest.fixture(scope="session", autouse=True)
def ros_logs(tmp_path_factory):
    """Have nodes log where pytest removes what earlier runs left."""
    os.environ["ROS_LOG_DIR"] = str(tmp_path_factory.mktemp("ros"))


@pytest.fixture(scope="module", autouse=True)
def domain():
    """Give each file a graph of its own: processes that were killed linger in theirs until DDS forgets them."""
    with graph.private_domain() as number:
        yield number


@pytest.fixture
def kept_signal_handlers():
    """Restore the signal handlers of the test process: the command line sets its own."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


def pytest_addoption(parser):
    """Add the option of test/real."""
    parser.addoption("--real-json", metavar="FILE", help="where the figures of test/real are written")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark rooms as a whole, and begin with the files that take longest, so that no worker is left with one at the end.

    Tests of other rooms that start nodes carry the mark ``graph`` themselves.
    """
    rooms = {path: path.relative_to(TESTS).as_posix() for path in {item.path for item in items}}
    ranks = {}
    for item in items:
        room = rooms[item.path]
        if room.startswith(PROCESSES):
            item.add_marker(pytest.mark.graph)
        if room.startswith(STUDIES):
            item.add_marker(pytest.mark.study)
        rank = next(
            (rank for rank, mark in enumerate(LONGEST_FIRST) if item.get_closest_marker(mark)), len(LONGEST_FIRST)
        )
        ranks[item.path] = min(rank, ranks.get(item.path, rank))
    items.sort(key=lambda item: ranks[item.path])


def pytest_report_header():
    """Name what the installation cannot run, as `colcon test` in a workspace of ROS."""
    return requirements.summary(LEFT_OUT)


def pytest_terminal_summary(terminalreporter):
    """Say it again where the result stands, and with -q, which has no header."""
    if LEFT_OUT:
        terminalreporter.write_line(requirements.summary(LEFT_OUT), yellow=True)
