"""Every way the running system can refuse.

The leaves say whose fault it is: the peer's protocol, the peer's identity, the operator's
configuration, or the network.
"""

from ca.errors import HintedError


class RossecError(HintedError):
    """Root of everything `rossec` refuses."""
