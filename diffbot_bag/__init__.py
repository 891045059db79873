"""Bags of a run: record, read and replay rosbag2 MCAP bags.

Conventions, stated once:

- Times are integers [ns]: ``log_time`` is the time of reception (simulated time, if that is in use), ``publish_time``
  the time of sending. The time of a bag is its ``log_time``.
- A message is kept as the bytes (CDR) received; only reports decode it.
- Quality of service is kept in rosbag2's words (:class:`diffbot_bag.bag.qos.Qos`).

Only ``*_node.py`` and ``ros_conversions.py`` import ROS.
"""
