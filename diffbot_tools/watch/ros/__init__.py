"""The ROS side of the live page: subscriptions of a robot, and requests to it."""
