"""Work on finished bags: no ROS, no command line. Long work reports its progress to a callback."""
