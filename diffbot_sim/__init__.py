"""The simulated world: the plant and its sensors, the ROS-free closed loop, and the compiled one.

Conventions as in :mod:`diffbot_core`. The plant shares no motion model with the filter, so that a mistake in one of
them shows.
"""
