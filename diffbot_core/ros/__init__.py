"""Base classes of nodes, their executor and signals, and ROS parameters from configuration types."""
