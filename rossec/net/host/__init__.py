"""The process at the other end of a local socket, as Linux knows it."""
