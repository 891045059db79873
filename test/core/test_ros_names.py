"""What rclpy cannot tell us: attributes of its Node that a subclass would break by using the same name."""

import inspect
import re

import pytest
import rclpy.node

from diffbot_bag import recorder_node, replay_node
from diffbot_control import controller_node, ekf_node
from diffbot_core.ros import node as ros_runtime
from diffbot_sim import plant_node
from diffbot_tools.demo import demo_node

MODULES = (ros_runtime, controller_node, ekf_node, plant_node, demo_node, recorder_node, replay_node)


def assigned(source: str) -> set[str]:
    return set(re.findall(r"self\.(\w+)(?:\s*:[^=\n]+)?\s*=[^=]", source))


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_no_attribute_of_rclpys_node_is_taken(module):
    taken = assigned(inspect.getsource(rclpy.node.Node)) | set(dir(rclpy.node.Node))
    assert {"_parameters", "_publishers", "_clock"} <= taken
    own = [
        cls
        for _, cls in inspect.getmembers(module, inspect.isclass)
        if cls.__module__ == module.__name__ and issubclass(cls, rclpy.node.Node)
    ]
    assert own, "the module has a node"
    clashes = {cls.__name__: sorted(assigned(inspect.getsource(cls)) & taken) for cls in own}
    assert clashes == {cls.__name__: [] for cls in own}
