"""What of the live page speaks ROS."""
