"""Opens the tokens that a peer presents: by the root, the list and the masters of one domain.

Which domain is the caller's to say, from the name that is asked for; never the token's. Pure.
"""

from collections import OrderedDict
from hashlib import sha256
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.certificates import Identity, TrustAnchor
from ca.domains.standing import Standing
from ca.encoding import decode
from ca.errors import EncodingError
from grants.decision import RevocationCheck
from grants.errors import GrantError, GrantMalformed, GrantMissing
from grants.model import Grant
from grants.narrowing import check_one_domain
from grants.tail import check_tail
from grants.token import Verifier

MAX_PRESENTED: Final = 40 * 1024  # a header field holds 48 KiB
MAX_GRANTS: Final = 16
CACHE_SIZE: Final = 1024


class TokenOpener:
    """Verifies tokens, each once.

    Args:
        standing: which authorities count, and what they have revoked.

    Attributes:
        own_master: the key of the node's own master, which may renew grants of the own domain.
    """

    def __init__(self, standing: Standing) -> None:
        self._standing = standing
        self._own: Final = standing.anchors.own
        self._opened: OrderedDict[tuple[bytes, bytes], Grant] = OrderedDict()
        self.own_master: ec.EllipticCurvePublicKey | None = None

    def open_all(
        self, presented: bytes, domain: str, peer: Identity, now: int
    ) -> tuple[list[Grant], list[GrantError]]:
        """The valid grants, and the errors of the others: one that is refused is left out.

        Args:
            presented: a CBOR array of tokens.
            peer: who presents them; a chain must stay in one domain, a tail must be its own.

        Raises:
            GrantMalformed: not such an array.
        """
        grants: list[Grant] = []
        refusals: list[GrantError] = []
        label = self._label(domain)
        for data in _unpack(presented):
            try:
                grant = self._open_once(data, domain, now)
                check_one_domain(grant, label, peer.name)
                check_tail(grant, peer.name, tail=peer.wildcard)
                grants.append(grant)
            except GrantError as error:
                refusals.append(error)
        return grants, refusals

    def open(self, data: bytes, domain: str, now: int) -> Grant:
        """Verify a token of `domain`.

        Raises:
            GrantError: as `Verifier.open`; `GrantMissing` for a domain that is not listed.
        """
        return self._verifier(domain).open(data, now)

    def check_of(self, *domains: str) -> RevocationCheck:
        """Checks an entry on the lists of these domains; the own one may refuse any."""
        foreign = dict.fromkeys(domain for domain in domains if domain != self._own.domain)
        if not foreign:
            return self._standing.own.check

        def check(entry: bytes, now: int) -> None:
            self._standing.own.check(entry, now)
            for domain in foreign:
                self._standing.check(domain, entry, now)

        return check

    def _open_once(self, data: bytes, domain: str, now: int) -> Grant:
        """As `open`; the signature of one seen before is not checked again."""
        seen = self._root(domain).thumbprint, sha256(data).digest()
        known = self._opened.get(seen)
        if known is not None and known.not_before <= now < known.expires:
            self._opened.move_to_end(seen)
            return known
        grant = self.open(data, domain, now)
        self._opened[seen] = grant
        if len(self._opened) > CACHE_SIZE:
            self._opened.popitem(last=False)
        return grant

    def _verifier(self, domain: str) -> Verifier:
        is_own = domain == self._own.domain
        revocations = self._standing.own if is_own else self._standing.foreign(domain)
        held = None if revocations is None else revocations.current
        mine = (self.own_master,) if is_own and self.own_master is not None else ()
        return Verifier(
            self._root(domain).public_key,
            domain,
            (*mine, *self._standing.delegates(domain)),
            0 if held is None else held.seq,
            self.check_of(domain),
        )

    def _label(self, domain: str) -> str:
        if domain == self._own.domain:
            return ""
        listed = self._standing.anchors.listed_domain(domain)
        return "" if listed is None else listed.entry.label

    def _root(self, domain: str) -> TrustAnchor:
        if domain == self._own.domain:
            return self._own
        listed = self._standing.anchors.listed_domain(domain)
        if listed is None:
            raise GrantMissing(f"a grant of domain {domain!a}, which is not listed here")
        return listed.anchor


def _unpack(presented: bytes) -> list[bytes]:
    try:
        value = decode(presented, limit=MAX_PRESENTED)
    except EncodingError as error:
        raise GrantMalformed(f"unreadable list of grants: {error}") from error
    if not isinstance(value, list) or len(value) > MAX_GRANTS:
        raise GrantMalformed(f"expected a list of at most {MAX_GRANTS} grants")
    grants = [item for item in value if isinstance(item, bytes)]
    if len(grants) != len(value):
        raise GrantMalformed("the list of grants has an item that is not bytes")
    return grants
