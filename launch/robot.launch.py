"""Launch the filter and the controller on a robot, and optionally the recorder, the robot description and RViz.

Show the arguments: ros2 launch diffbot robot.launch.py --show-args
"""

from diffbot_tools.launch_files import robot

generate_launch_description = robot
