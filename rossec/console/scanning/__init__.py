"""Codes read from a browser's pictures: in a process without rights, which the supervisor starts."""
