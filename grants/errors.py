"""Every way a grant, a condition, a filter or a policy can be refused.

The leaves say whose fault it is: the issuer (malformed), the peer (forged, not its own, missing),
time (expired, revoked), or the person who wrote the rule (condition, filter).
"""

from ca.errors import HintedError


class GrantError(HintedError):
    """Root of everything `grants` refuses."""
