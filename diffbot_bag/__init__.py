"""Bags of a run: record, read and replay rosbag2 MCAP bags.

Conventions, stated once:

- Times are integers [ns]: ``log_time`` is the time of reception (simulated time, if that is in use), ``publish_time``
  the time of sending. The time of a bag is its ``log_time``.
- A message is recorded, cut and replayed as the bytes received (CDR). `messages` decodes it for reports.
- Quality of service has the words of rosbag2 (:class:`diffbot_bag.qos.Qos`).

Only the nodes and the modules that they alone import (conversions, node_parameters, publications, recorded_topic)
import ROS.
"""
