"""The plan of a launch as actions of ROS's launch."""
