"""What a node checks before it takes an identity: that it is its own, under the offered root."""

from collections.abc import Sequence

from ca.certificates import TrustAnchor
from ca.errors import CAError, OfferRefused
from ca.requests import IdentityRequest


def check_issued(
    root: bytes, chain: Sequence[bytes], own: IdentityRequest, now: int
) -> TrustAnchor:
    """Return the anchor in `root` if `chain` is exactly the identity that was asked for.

    Raises:
        OfferRefused: invalid certificates, or for another key or name.
    """
    try:
        anchor = TrustAnchor.load(root)
        identity = anchor.verify(chain, now)
    except CAError as error:
        raise OfferRefused(f"invalid offer: {error}", error.hint) from error
    if identity.thumbprint != own.thumbprint:
        raise OfferRefused("an identity for another key")
    offered = (identity.domain, identity.name, identity.wildcard)
    if offered != (own.domain, own.name, own.wildcard):
        raise OfferRefused("an identity for another name than the one asked for")
    return anchor
