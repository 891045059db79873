"""Programs of the ROS installation or overlay of this process."""

import random
from pathlib import Path

import graph
from ament_index_python.packages import get_package_prefix
from robot import distance, turned


def program(package, executable, *arguments, **options):
    """Run an executable of a package while the ``with`` block lasts."""
    path = Path(get_package_prefix(package)) / "lib" / package / executable
    return graph.process(str(path), *map(str, arguments), **options)


def ros2(*words, **options):
    """Run a command of ROS while the ``with`` block lasts."""
    return graph.process("ros2", *map(str, words), **options)


def errors_of_goals(driving, count, span):
    """Drive to random goals within ``span`` [m]; return the larger error [m], [rad] of the true pose at each answer."""
    chance, errors = random.Random(5), []
    for _ in range(count):
        goal = tuple(round(chance.uniform(-span, span), 2) for _ in range(3))
        driving.send_goal(*goal)
        driving.wait_for_state("goal reached", 60.0)
        pose = driving.true_pose()
        errors.append(max(distance(pose, goal), turned(pose, goal)))
    return errors
