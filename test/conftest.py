"""Environment of all tests, set before ROS is imported: each pytest worker has a ROS domain of its own."""

import atexit
import os
import signal
import sys
from pathlib import Path

import graph
import pytest
import requirements

from diffbot_tools.processes import PrivateDomain, localhost_discovery

try:
    from hypothesis import settings
except ImportError:
    # requirements.py leaves out the tests that need hypothesis.
    pass
else:
    # The same examples in every run; --hypothesis-profile=explore finds new examples.
    settings.register_profile("repeatable", derandomize=True, deadline=None)
    settings.register_profile("explore", derandomize=False, deadline=None)
    settings.load_profile("repeatable")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # In the background of a shell, SIGINT is ignored, and would also be ignored by the processes of the tests.
    signal.signal(signal.SIGINT, signal.default_int_handler)
# Nodes do not use files that others can write.
os.umask(0o022)
# Wrong types in a message field raise instead of being sent.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ |= localhost_discovery()
_DOMAIN = PrivateDomain()
atexit.register(_DOMAIN.release)
os.environ["ROS_DOMAIN_ID"] = str(_DOMAIN.id)
# With wheels, the environment contains the packages: ignore other installations, but not an overlay on this environment
# (`make real`).
_PREFIXES = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
if (Path(sys.prefix) / "share" / "std_msgs").is_dir() and sys.prefix not in _PREFIXES:
    os.environ.pop("AMENT_PREFIX_PATH", None)

TESTS = Path(__file__).parent
LEFT_OUT = requirements.left_out(requirements.missing_packages())
collect_ignore = list(LEFT_OUT)
PROCESSES = ("graph/", "faults/", "real/", "slow/")
LONGEST_FIRST = (("install",), ("study", "graph"))
"""Marks, sorted by the time that a file of their tests takes. Files of marks in one tuple alternate: studies wait for
each other while they compile, and tests of nodes use the other cores meanwhile."""
STUDIES = (
    "lab/benchmark/",
    "lab/campaign/",
    "lab/test_filter_benchmark.py",
    "lab/test_paper.py",
    "lab/stability/",
    "sim/test_batch.py",
    "sim/test_laws.py",
    "sim/test_one_filter.py",
    "tools/calibration/",
)


@pytest.fixture(scope="session", autouse=True)
def ros_logs(tmp_path_factory):
    """Let nodes log to a folder that pytest removes."""
    os.environ["ROS_LOG_DIR"] = str(tmp_path_factory.mktemp("ros"))


@pytest.fixture(scope="module", autouse=True)
def domain():
    """Give each file a domain of its own: killed processes remain in a graph until DDS removes them."""
    with graph.private_domain() as number:
        yield number


@pytest.fixture
def kept_signal_handlers():
    """Restore the signal handlers of the test process, which the command line replaces."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


def pytest_addoption(parser):
    """Add the option of test/real."""
    parser.addoption("--real-json", metavar="FILE", help="where the figures of test/real are written")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark all tests of some rooms, and run the longest files first, so that all workers end at about the same time.

    Tests of other rooms that start nodes carry the mark ``graph`` themselves.
    """
    rooms = {path: path.relative_to(TESTS).as_posix() for path in {item.path for item in items}}
    marks = {}
    for item in items:
        room = rooms[item.path]
        if room.startswith(PROCESSES):
            item.add_marker(pytest.mark.graph)
        if room.startswith(STUDIES):
            item.add_marker(pytest.mark.study)
        marks.setdefault(item.path, set()).update(mark.name for mark in item.iter_markers())
    places = {}
    for rank, group in enumerate(LONGEST_FIRST):
        for position, mark in enumerate(group):
            files = [path for path in marks if mark in marks[path] and path not in places]
            places |= {path: (rank, index, position) for index, path in enumerate(files)}
    items.sort(key=lambda item: places.get(item.path, (len(LONGEST_FIRST), 0, 0)))


def pytest_report_header():
    """Name the tests that this installation cannot run, for example in a workspace of ROS."""
    return requirements.summary(LEFT_OUT)


def pytest_terminal_summary(terminalreporter):
    """Repeat the names beside the result, and with -q, which does not print a header."""
    if LEFT_OUT:
        terminalreporter.write_line(requirements.summary(LEFT_OUT), yellow=True)
