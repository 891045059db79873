"""Nodes at the bounds of their parameters: no message holds a number that is not finite, and no node dies."""

import math

import numpy as np
from extremes import extreme_values
from rclpy.qos import QoSProfile, ReliabilityPolicy
from robot import pose_stamped, robot

from diffbot_bag.ros_conversions import message_class
from diffbot_control.controller_node import ControllerNodeConfig
from diffbot_control.ekf_node import EkfNodeConfig
from diffbot_core.schema import parameters_of
from diffbot_sim.plant_node import PlantNodeConfig

CONFIGS = {"plant": PlantNodeConfig, "ekf": EkfNodeConfig, "controller": ControllerNodeConfig}
SENSORS = {"heading_rate": 10.0, "landmark_rate": 10.0}
MAP = {"landmark_ids": [1, 2], "landmark_x": [2.0, -3.0], "landmark_y": [1.0, 4.0]}
WHEELS = {"wheel_radius": 10.0, "wheel_separation": 0.001}
SAMPLE = 5
"""parameters changed of each node"""


def floats_in(message):
    """Yield every floating-point number of a message."""
    for field in message.get_fields_and_field_types():
        value = getattr(message, field)
        for one in [value] if isinstance(value, (str, bytes)) or not hasattr(value, "__iter__") else value:
            if hasattr(one, "get_fields_and_field_types"):
                yield from floats_in(one)
            elif isinstance(one, (float, np.floating)):
                yield float(one)


def subscribe_to_all(running):
    """Return, by topic, the messages of everything that is published from here on."""
    peer = running.peer
    peer.wait_for_subscribers(running.goals)
    received = {}
    for topic, types in peer.node.get_topic_names_and_types():
        if topic not in ("/rosout", "/parameter_events"):
            qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
            received[topic] = peer.subscribe(message_class(types[0]), topic, qos)
    return received


def check(running, received, *context):
    for topic, messages in received.items():
        for message in messages:
            assert all(map(math.isfinite, floats_in(message))), (topic, message, context)
        messages.clear()
    for name, process in running.processes.items():
        assert process.popen.poll() is None, (name, context, process.output)
        assert "Traceback" not in process.output


def test_parameters_set_to_their_bounds_while_the_robot_drives():
    rng = np.random.default_rng(1)
    with robot({**SENSORS, **MAP}, MAP) as running:
        received = subscribe_to_all(running)
        running.goals.publish(pose_stamped(50.0, 10.0, 0.0))
        running.peer.spin_until(lambda: all(received[f"/{topic}"] for topic in ("pose", "landmarks", "cmd_vel")))
        for node, config_type in CONFIGS.items():
            numbers = [one for one in parameters_of(config_type) if one.type is float and not one.spec.read_only]
            for place in rng.choice(len(numbers), SAMPLE, replace=False):
                one = numbers[place]
                for value in (one.spec.minimum, one.spec.maximum, extreme_values(one, one.default, rng)[-1]):
                    result = running.set_parameter(node, one.name, value)
                    assert result.successful or f"{one.name} = " in result.reason
                    running.peer.spin_for(0.05)
                    check(running, received, node, one.name, value)
                assert running.set_parameter(node, one.name, one.default).successful


def test_nodes_that_start_at_the_bounds_of_their_wheels():
    plant = {**SENSORS, **MAP, **WHEELS, "eps_omega_max": 1000.0, "eps_v_max": 1000.0, "encoder_noise": 1.0}
    ekf = {**MAP, **WHEELS, "odometry_source": "joint_states", "wheel_separation_sigma": 0.2, "wheel_noise": 1.0}
    controller = {**WHEELS, "linear.x.max_velocity": 1000.0, "angular.z.max_velocity": math.inf, "brake": 1e-6}
    with robot(plant, ekf, controller, only=("robot", "plant")) as running:
        received = subscribe_to_all(running)
        running.goals.publish(pose_stamped(1e6, -1e6, 0.0))
        running.peer.spin_until(lambda: len(received["/odom"]) > 20 and received["/cmd_vel"], 15.0, "the drive")
        odometry = max((abs(one.twist.twist.angular.z) for one in received["/odom"]), default=0.0)
        assert odometry > 100.0
        check(running, received)
