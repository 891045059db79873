"""The fault suite: short in ``make test``, full with ``--faults=full``; each process of ``make faults`` has a share."""

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
    share = tuple(map(int, config.getoption("--faults-share").split("/")))
    path, full = config.getoption("--faults-results"), config.getoption("--faults") == "full"
    config.stash[_RECORD] = Record(full, share, path and Path(path))


def pytest_collection_modifyitems(config, items):
    """Give the full form the time that it needs."""
    if config.getoption("--faults") == "full":
        for item in items:
            if item.get_closest_marker("fault"):
                item.add_marker(pytest.mark.timeout(_FULL_TIMEOUT))


def pytest_sessionfinish(session):
    """Note what the processes have shown, also after Ctrl-C or a failure."""
    session.config.stash[_RECORD].finish()


@pytest.fixture(scope="session")
def record(pytestconfig):
    return pytestconfig.stash[_RECORD]


@pytest.fixture(scope="session")
def trials(record):
    """Return a context of the trials of a promise by its key."""
    return record.trials


@pytest.fixture
def seeded(request, pytestconfig):
    """Return random numbers that depend on the name of the test and the share of its trials alone."""
    share = pytestconfig.getoption("--faults-share")
    return random.Random(request.node.name + share.removesuffix("0/1"))


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
