"""What keeps messages from their subscriptions, in words."""

import pytest

from diffbot_core.endpoints import (
    TWIST,
    TWIST_STAMPED,
    Endpoint,
    command_problem,
    followed_type,
    input_problem,
)

ODOMETRY = "nav_msgs/msg/Odometry"
EKF = Endpoint("/ekf", ODOMETRY, is_reliable=False)
CONTROLLER = Endpoint("/controller", TWIST)
BASE, STAMPED_BASE = Endpoint("/base", TWIST), Endpoint("/base", TWIST_STAMPED)
ECHO, RECORDER = Endpoint("/_ros2cli_4711", TWIST_STAMPED), Endpoint("/r1/recorder", TWIST)


@pytest.mark.parametrize(
    ("own", "publishers", "problem"),
    [
        (EKF, [], "nothing publishes /odom: start its source, or remap /odom"),
        (EKF, [Endpoint("/base", ODOMETRY)], ""),
        (EKF, [Endpoint("/base", "x/msg/Y")], "/base publishes /odom as Y: convert it to Odometry"),
        (EKF, [Endpoint("/base", "x/msg/Y"), Endpoint("/other", ODOMETRY)], ""),
        (
            EKF._replace(is_reliable=True),
            [Endpoint("/base", ODOMETRY, is_reliable=False)],
            "/base does not publish /odom as reliable, which /ekf requests: change the reliability of one of them",
        ),
        (
            EKF._replace(is_latched=True),
            [Endpoint("/base", ODOMETRY)],
            "/base does not publish /odom as transient_local, which /ekf requests: "
            "change the durability of one of them",
        ),
    ],
)  # fmt: skip
def test_an_input_that_no_publisher_matches_names_the_publisher_and_the_remedy(own, publishers, problem):
    assert input_problem("/odom", own, publishers) == problem


@pytest.mark.parametrize(
    ("present", "subscriptions", "followed"),
    [
        (TWIST, [], TWIST),
        (TWIST, [STAMPED_BASE], TWIST_STAMPED),
        (TWIST_STAMPED, [BASE], TWIST),
        (TWIST_STAMPED, [], TWIST_STAMPED),
        (TWIST, [STAMPED_BASE, BASE], TWIST),
        (TWIST_STAMPED, [STAMPED_BASE, BASE], TWIST_STAMPED),
        (TWIST, [STAMPED_BASE, RECORDER], TWIST_STAMPED),
        (TWIST, [ECHO], TWIST),
        (TWIST, [STAMPED_BASE._replace(type="std_msgs/msg/Bool")], TWIST),
    ],
)
def test_commands_follow_the_type_of_the_bases_and_keep_theirs_where_these_do_not_agree(
    present, subscriptions, followed
):
    assert followed_type(present, subscriptions) == followed


@pytest.mark.parametrize(
    ("subscriptions", "elsewhere", "problem"),
    [
        ([BASE], (), ""),
        ([BASE, RECORDER], (), ""),
        ([], (), "nobody subscribes to /cmd_vel: start the driver of the base"),
        (
            [],
            ["/base/cmd_vel"],
            "nobody subscribes to /cmd_vel: start the driver of the base, or remap cmd_vel to /base/cmd_vel",
        ),
        (
            [ECHO, RECORDER],
            (),
            "nobody but /_ros2cli_4711, /r1/recorder subscribes to /cmd_vel: start the driver of the base",
        ),
        (
            [BASE, STAMPED_BASE._replace(node="/mux")],
            (),
            "/mux subscribes to /cmd_vel as TwistStamped, the commands are Twist: set cmd_vel_type to twist_stamped",
        ),
        (
            [BASE._replace(type="ackermann_msgs/msg/AckermannDrive")],
            (),
            "/base subscribes to /cmd_vel as AckermannDrive, the commands are Twist: give it Twist or TwistStamped",
        ),
        (
            [BASE._replace(is_latched=True)],
            (),
            "/base requests transient_local durability of /cmd_vel: "
            "set qos_overrides./cmd_vel.publisher.durability to transient_local",
        ),
    ],
)
def test_commands_that_a_base_does_not_receive_are_named_with_the_remedy(subscriptions, elsewhere, problem):
    assert command_problem("/cmd_vel", CONTROLLER, subscriptions, elsewhere) == problem
