"""The same nodes with a simulated robot, the plant.

ros2 launch diffbot simulation.launch.py --show-args
"""

from diffbot_tools.launch_files import simulation

generate_launch_description = simulation
