"""The base class of all nodes, their executor and signals, and ROS parameters from configuration types."""
