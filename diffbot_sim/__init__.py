"""Simulation: the plant and its sensors, the closed loop without ROS, and the compiled closed loop.

Conventions as in :mod:`diffbot_core`. The plant and the filter do not share a motion model, so that a mistake in one of
them becomes visible.
"""
