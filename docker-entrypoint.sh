#!/bin/bash
# Runs a command with ROS and this workspace sourced.
set -e
source /opt/ros/jazzy/setup.bash
source /ws/install/setup.bash
exec "$@"
