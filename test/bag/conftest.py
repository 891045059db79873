"""Fixtures of the tests of bags."""

from terminals import terminal  # noqa: F401 - a fixture
