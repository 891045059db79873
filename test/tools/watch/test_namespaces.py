"""`diffbot watch`: the namespaces of the robots."""

import pytest

from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import build
from diffbot_tools.watch.parameters import WatchConfig, robot_names


def test_namespaces_of_ros_are_allowed():
    given = ("", "/robot1", "fleet/_2/")
    assert robot_names(build(WatchConfig, {"namespaces": given}).namespaces) == ("robot", "robot1", "fleet/_2")


@pytest.mark.parametrize("names", [["a-b"], ["2robots"], ["a//b"], ["a b"], ["r1", "/r1/"], []])
def test_names_that_ros_refuses_and_repeated_names_are_refused(names):
    with pytest.raises(InvalidValueError, match="namespaces"):
        build(WatchConfig, {"namespaces": names})
