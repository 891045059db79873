"""What runs on the robot: the switching law (``law``), the filter (``filter``) and their nodes.

``law`` and ``filter`` do not import each other; only the nodes and the package ``ros`` import ROS. Conventions as in
:mod:`diffbot_core`.
"""
