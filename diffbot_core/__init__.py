"""Foundation of the other packages: errors, configuration schema, geometry, kinematics, uncertainty and files.

Conventions (REP-103, REP-105):

- Units are SI. Angles are in radians, wrapped to (-pi, pi]. Yaw is counter-clockwise, x points forward.
- Frames are ``map`` (world), ``odom`` (drifts) and ``base_link`` (robot). A *goal frame* has its origin at the goal
  pose and its x axis along the goal's heading; the laws work in this frame.
- Time in messages and between modules is an integer number of nanoseconds. A sampling time is a float in seconds.
- Symbols follow the paper (N. T. T. Van, P. M. Duong, T. Q. Vinh, VCM-2014); docs/explanation/symbols.md lists them.

Only the subpackage ``ros`` imports ROS.
"""
