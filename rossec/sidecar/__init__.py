"""Secures unmodified programs: a loopback master for them, and guarded connections."""
