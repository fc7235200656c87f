"""Secure connections for threads, with the socket methods that rospy uses."""
