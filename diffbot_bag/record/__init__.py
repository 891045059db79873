"""Recording without ROS: chunks, files, splits, and latched messages."""
