"""Record, read, check, cut, repair and replay rosbag2 MCAP bags.

Conventions:

- Times are integers in [ns]. ``log_time`` is the time of reception, in simulated time if that is used.
  ``publish_time`` is the time of sending. Messages are ordered by ``log_time``.
- Messages are recorded, cut and replayed as CDR bytes. Only :mod:`diffbot_bag.messages` decodes them.
- QoS policies have the names of rosbag2, see :class:`diffbot_bag.qos.Qos`.

Only the nodes and the modules conversions, node_parameters, publications and recorded_topic import ROS.
"""
