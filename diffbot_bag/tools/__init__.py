"""Work on recorded bags without ROS: figures, checks, and writing them anew."""
