"""Enrollment: a node gets its identity and learns whom to trust, over a network nobody trusts.

Two state machines without sockets, clock or dice: `node.NodeEnrollment` and
`authority.AuthorityEnrollment`. What they say is in `messages`, what they sign in `transcript`. The
protocol, with the reason for each step, is docs/spec/enrollment.md.
"""

from typing import Final

WINDOW: Final = 300  # seconds: how long a screen code holds, and how long a person may compare
NONCE_SIZE: Final = 16
