"""The revocation list a node had when it stopped: an older one is refused afterwards."""

from ca.certificates import TrustAnchor
from ca.revocation.state import Revocations
from rossec.home import NodeHome


def saved_revocations(home: NodeHome, anchor: TrustAnchor, now: int) -> Revocations:
    """The newest list that the node in `home` has seen, not yet confirmed.

    Raises:
        RevocationRefused: the list is not the authority's.
        ConfigurationError: it cannot be read.
    """
    revocations = Revocations(anchor.public_key)
    saved = home.load_revocations()
    if saved is not None:
        revocations.update(saved, now)
    return revocations
