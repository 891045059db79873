"""The ROS part of the look at a running robot."""
