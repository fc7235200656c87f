"""The ROS graph from the command line: topics, services, parameters."""
