"""Bags of a run: record, read and replay rosbag2 MCAP bags.

Conventions, stated once:

- Times are integers of nanoseconds: ``log_time`` is when a message was received (or the simulated time then),
  ``publish_time`` when it was sent. Time in a bag means ``log_time``.
- A message stays the bytes (CDR) that came over the wire; only reports decode it.
- Quality of service is held as rosbag2's words (:class:`diffbot_bag.qos.Qos`).

Every module here but ``*_node.py`` and ``ros_conversions.py`` is free of ROS.
"""
