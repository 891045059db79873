"""Fixtures of the tests of the graph."""

import pytest


@pytest.fixture
def nodes():
    """A context for each test: what a node has published stays listed as long as an executor holds its handles."""
    import one_process

    with one_process.nodes() as running:
        yield running
