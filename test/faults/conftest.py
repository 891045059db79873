"""The fault suite: short in ``make test``, full with ``--faults=full`` (``make faults``), which writes its results."""

import contextlib
import random
from pathlib import Path

import pytest
from robot import robot
from trials import Record
from witness import Witness

_FULL_TIMEOUT = 3600
_RECORD = pytest.StashKey[Record]()


def pytest_configure(config):
    """Have one record for the run."""
    config.stash[_RECORD] = Record()


def pytest_collection_modifyitems(config, items):
    """Give the full form the time that it needs."""
    if config.getoption("--faults") == "full":
        for item in items:
            if item.get_closest_marker("fault"):
                item.add_marker(pytest.mark.timeout(_FULL_TIMEOUT))


def pytest_sessionfinish(session):
    """Write the results, also after Ctrl-C or a failure."""
    record, path = session.config.stash[_RECORD], session.config.getoption("--faults-json")
    if path and record.rows:
        record.write(Path(path))


@pytest.fixture(scope="session")
def record(pytestconfig):
    return pytestconfig.stash[_RECORD]


@pytest.fixture(scope="session")
def trials(pytestconfig, record):
    """Return a context of the trials of a promise by its key."""
    full = pytestconfig.getoption("--faults") == "full"
    capture = pytestconfig.pluginmanager.getplugin("capturemanager")
    shown = capture.global_and_fixture_disabled if full and capture else contextlib.nullcontext
    return lambda key: record.trials(key, full, shown)


@pytest.fixture
def seeded(request):
    """Return random numbers that depend on the name of the test alone."""
    return random.Random(request.node.name)


@pytest.fixture(scope="module")
def observed(record, request):
    """Return a context of a robot with its witness; at the end its processes and messages are audited."""

    @contextlib.contextmanager
    def begin(*arguments, **options):
        with robot(*arguments, **options) as running:
            witness = Witness(running)
            yield witness
            witness.audit(record.counts(request.path.stem))

    return begin
