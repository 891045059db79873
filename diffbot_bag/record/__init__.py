"""Recording without ROS: chunks, files, splits, latched messages, snapshots and facts of the host."""
