"""The filter and the controller on a robot, with recorder, robot description and RViz if asked.

ros2 launch diffbot robot.launch.py --show-args
"""

from diffbot_tools.launch_files import robot

generate_launch_description = robot
