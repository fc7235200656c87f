"""The ROS master, reached only through the channel: every call bound to an identity."""
