"""The texts that say why messages do not reach a subscription."""

import pytest

from diffbot_core.endpoints import TWIST, TWIST_STAMPED, Endpoint, command_problem, followed_type, input_problem

ODOMETRY = "nav_msgs/msg/Odometry"
EKF, DRIVER = Endpoint("/ekf", ODOMETRY, is_reliable=False), Endpoint("/base", ODOMETRY)
CONTROLLER, BASE, STAMPED = Endpoint("/controller", TWIST), Endpoint("/base", TWIST), Endpoint("/mux", TWIST_STAMPED)
ECHO, RECORDER = Endpoint("/_ros2cli_4711", TWIST_STAMPED), Endpoint("/r1/recorder", TWIST)
MISSING = "nothing publishes /r1/odom: "


@pytest.mark.parametrize(
    ("own", "publishers", "elsewhere", "problem"),
    [
        (EKF, [DRIVER._replace(type="x/msg/Y"), DRIVER], [], ""),
        (EKF, [DRIVER._replace(type="x/msg/Y")], [], "/base publishes /r1/odom as Y: convert it to Odometry"),
        (EKF, [], ["/wheels", "/drift"], MISSING + "start its source, or remap /r1/odom to /drift or /wheels"),
        (EKF, [], ["/odom", "/wheels"], MISSING + "run all nodes in the namespace /, or remap /r1/odom to /odom"),
        (
            *(EKF._replace(is_reliable=True), [DRIVER._replace(is_reliable=False)], []),
            "/base does not publish /r1/odom as reliable, which /ekf requests: change the reliability of one of them",
        ),
    ],
)
def test_an_input_without_a_matching_publisher_is_reported_with_the_remedy(own, publishers, elsewhere, problem):
    assert input_problem("/r1/odom", own, publishers, elsewhere) == problem


@pytest.mark.parametrize(
    ("present", "subscriptions", "followed"),
    [
        (TWIST, [STAMPED], TWIST_STAMPED),
        (TWIST, [STAMPED, RECORDER], TWIST_STAMPED),
        (TWIST, [STAMPED, BASE], TWIST),
        (TWIST_STAMPED, [STAMPED, BASE], TWIST_STAMPED),
        (TWIST, [ECHO], TWIST),
        (TWIST, [STAMPED._replace(type="std_msgs/msg/Bool")], TWIST),
    ],
)
def test_commands_have_the_type_of_the_bases_if_all_bases_agree(present, subscriptions, followed):
    assert followed_type(present, subscriptions) == followed


@pytest.mark.parametrize(
    ("subscriptions", "elsewhere", "problem"),
    [
        ([BASE, RECORDER], [], ""),
        (
            *([ECHO, RECORDER], ["/b/v"]),
            "no base subscribes to /cmd_vel, only /_ros2cli_4711, /r1/recorder: "
            "start the driver of the base, or remap cmd_vel to /b/v",
        ),
        (
            *([BASE, STAMPED], []),
            "/mux subscribes to /cmd_vel as TwistStamped, but the commands are Twist: "
            "set cmd_vel_type to twist_stamped",
        ),
        (
            *([BASE._replace(type="ackermann_msgs/msg/AckermannDrive")], []),
            "/base subscribes to /cmd_vel as AckermannDrive, but the commands are Twist: "
            "change its type to Twist or TwistStamped",
        ),
        (
            *([BASE._replace(is_latched=True)], []),
            "/base requests transient_local durability of /cmd_vel: "
            "set qos_overrides./cmd_vel.publisher.durability to transient_local",
        ),
    ],
)
def test_a_base_that_does_not_receive_the_commands_is_reported_with_the_remedy(subscriptions, elsewhere, problem):
    assert command_problem("/cmd_vel", CONTROLLER, subscriptions, elsewhere) == problem
