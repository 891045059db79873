"""Foundation of the other packages: errors, the schema of configurations, geometry, kinematics, uncertainty, files.

Conventions, stated once (REP-103, REP-105):

- SI units; angles in radians, wrapped to (-pi, pi]; yaw counter-clockwise, x forward.
- Frames: ``map`` (world), ``odom`` (drifts), ``base_link`` (robot). A *goal frame* has its origin in the goal pose
  and its x axis along the goal's heading; the laws live in it.
- Time in messages and between modules is an integer of nanoseconds; a sampling time is a float of seconds.
- Symbols are those of the paper (N. T. T. Van, P. M. Duong, T. Q. Vinh, VCM-2014), listed in
  docs/explanation/symbols.md.

Only the package ``ros`` imports ROS.
"""
