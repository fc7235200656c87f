"""The ROS master, reached only through the channel: every call is bound to an identity."""
