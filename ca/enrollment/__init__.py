"""Enrollment: a node gets its identity and its trust anchor over an untrusted network.

Two sans-IO state machines: `node.NodeEnrollment` and `authority.AuthorityEnrollment`. The messages
are in `messages`, the signed statements in `transcript`. The protocol, with the reason for each
step, is docs/spec/enrollment.md.
"""

from typing import Final

WINDOW: Final = 300  # seconds: lifetime of a screen code, and time for a person to compare the digits
NONCE_SIZE: Final = 16
