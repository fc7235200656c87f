"""Decisions of a sidecar on programs' calls and connections. Pure."""
