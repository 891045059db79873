"""The world: plant, noise, the ROS-free closed loop, the demonstration and the command ``diffbot``.

Conventions as in :mod:`diffbot_control`. The plant shares no motion model with the filter, so that a mistake in one of
them shows.
"""
