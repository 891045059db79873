"""Launch the nodes of robot.launch.py and a simulated robot.

Show the arguments: ros2 launch diffbot simulation.launch.py --show-args
"""

from diffbot_tools.launch_files import simulation

generate_launch_description = simulation
