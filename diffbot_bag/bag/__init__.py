"""A bag of rosbag2: its files, metadata, message definitions and quality of service."""
