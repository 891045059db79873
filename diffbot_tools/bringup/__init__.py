"""What the launch files start: their arguments and the nodes that follow from them, as plain data."""
