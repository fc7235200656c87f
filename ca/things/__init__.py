"""Constrained things: what the authority says of them, and the credentials it says it about."""
