"""Fixtures of the tests of the page."""

import pytest
import view_bags


@pytest.fixture(scope="session")
def circle(tmp_path_factory):
    """A bag of 10 s on a circle, 50 Hz: see view_bags.drive."""
    return view_bags.write(tmp_path_factory.mktemp("bags") / "circle", view_bags.drive())


@pytest.fixture(scope="module")
def new_page():
    """Return a function that opens a tab, see browser.chromium."""
    import browser

    with browser.chromium() as make:
        yield make
