"""Replay of a bag in time, free of ROS."""
