"""Enrollment on real sockets: thin shells around the state machines of `ca.enrollment`."""
