"""The grants a node holds, and the authorization of its peers, which happens here only.

Pure: grants, revocations and `now` in; a `Decision` or an error out. Least disclosure: of the
grants this node holds, a peer receives only those that cover the request.
"""

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.certificates import Identity, TrustAnchor
from ca.encoding import Value, decode, encode
from ca.errors import CAError, EncodingError, RevocationsStale
from ca.revocation.state import Revocations, open_timestamp
from grants.decision import Decision, authorize
from grants.errors import GrantError, GrantMalformed, GrantMissing
from grants.model import Grant, Right
from grants.narrowing import check_one_domain
from grants.token import Verifier, peek

FIELD: Final = "rossec_grants"
NO_LIST: Final = (
    "the master has no revocation list yet",
    "at the authority: rossec ca refresh, then rossec ca publish; until then no peer is trusted",
)
MAX_PRESENTED: Final = 40 * 1024  # a header field holds 48 KiB
MAX_GRANTS: Final = 16
CACHE_SIZE: Final = 1024
_ARRAY_HEAD, _BYTES_HEAD = 3, 5  # at most, in CBOR


@dataclass(frozen=True)
class HeldGrant:
    """A grant this node holds.

    Args:
        grant: its content; `expires` as renewed.
        original: the bytes the authority signed.
        token: the bytes to present.
        since: when it was last renewed, or becomes valid.
    """

    grant: Grant
    original: bytes
    token: bytes
    since: int


class Access:
    """Holds the grants of a node and checks those of its peers."""

    def __init__(
        self, anchor: TrustAnchor, revocations: Revocations, held: Iterable[bytes] = ()
    ) -> None:
        self._anchor = anchor
        self._revocations = revocations
        self._held: dict[bytes, HeldGrant] = {}
        self._verified: OrderedDict[bytes, Grant] = OrderedDict()
        self._delegate: ec.EllipticCurvePublicKey | None = None
        for data in held:
            self.hold(data)

    def hold(self, data: bytes) -> None:
        """Add a token to those this node can present: a grant as signed, or a chain."""
        grant = peek(data)
        self._held.setdefault(grant.id, HeldGrant(grant, data, data, grant.not_before))

    def hold_renewed(self, token: bytes, now: int) -> None:
        """Replace a grant this node holds with the token the master renewed.

        Raises:
            GrantError: it is invalid, or this node does not hold the grant.
        """
        grant = self._verifier().open(token, now)
        known = self._held.get(grant.id)
        if known is None:
            raise GrantMissing(f"the renewed grant {grant.short_id} is not held by this node")
        self._held[grant.id] = HeldGrant(grant, known.original, token, now)

    def held_grants(self) -> list[HeldGrant]:
        """All grants this node holds, expired ones too, except those known to be revoked."""
        revoked = self._revocations.entries
        return [held for held in self._held.values() if revoked.isdisjoint(held.grant.revocable)]

    @property
    def epoch(self) -> int:
        """The epoch of the revocation list held; 0 without one."""
        held = self._revocations.current
        return 0 if held is None else held.epoch

    def update_revocations(
        self,
        revocations: bytes,
        timestamp: bytes,
        master: Identity,
        now: int,
        persist: Callable[[bytes], None],
    ) -> None:
        """Take over a newer list (empty: the one held is the newest) and its timestamp.

        A valid list is kept even when the timestamp is not accepted.

        Raises:
            RevocationsStale: the master sends the list without a timestamp.
            CAError: the list or timestamp is refused or missing, or the master's key is revoked.
        """
        if not timestamp and not revocations and self._revocations.current is None:
            raise CAError(*NO_LIST)
        if revocations:
            self._revocations.update(revocations, now, persist)
        if revocations and not timestamp:
            self._revocations.expire_confirmation()
            raise RevocationsStale(
                "the master reports this node as revoked: the revocation list without a timestamp",
                "its identity, or the intermediate above it, is revoked: enroll the node anew",
            )
        with suppress(RevocationsStale):  # the timestamp may end it; that of a revoked key may not
            self.check_peer(master, now)
        self._revocations.confirm(open_timestamp(timestamp, master.public_key), now)
        self.check_peer(master, now)
        self._delegate = master.public_key

    def expire_confirmation(self, until: int) -> None:
        """End the confirmation of the list at `until`: the clock it was received by went back."""
        self._revocations.expire_confirmation(until)

    @property
    def unproved(self) -> list[bytes]:
        """Entries of a tree of revocations that wait for a proof."""
        return self._revocations.unproved

    def add_proof(self, entry: bytes, proof: bytes) -> None:
        """Take a proof. Raises `RevocationRefused`."""
        self._revocations.add_proof(entry, proof)

    def current(self, now: int) -> list[bytes]:
        """The grants that are valid now and not known to be revoked, the latest expiry first."""
        return [held.token for held in self._current(now)]

    def present(self, right: Right, name: str, now: int) -> bytes:
        """Header field that proves `right` on `name`: the array of the grants that cover it.

        A peer accepts a limited number and size; those that expire last are sent.
        """
        covering = [held.token for held in self._current(now) if held.grant.covers(right, name)]
        return encode(list[Value](_fitting(covering)))

    def holds(self, right: Right, name: str, now: int) -> bool:
        """Whether a grant this node holds covers `right` on `name` now."""
        return any(held.grant.covers(right, name) for held in self._current(now))

    def _current(self, now: int) -> list[HeldGrant]:
        usable = [
            held for held in self.held_grants() if held.grant.not_before <= now < held.grant.expires
        ]
        return sorted(usable, key=lambda held: held.grant.expires, reverse=True)

    def check_peer(self, peer: Identity, now: int) -> None:
        """Raise a `CAError` when the identity of `peer` is revoked, or this is not known.

        All its keys are checked: stale data on the first must not hide that its intermediate is
        revoked.
        """
        stale: RevocationsStale | None = None
        for key in peer.keys:
            try:
                self._revocations.check(key, now)
            except RevocationsStale as error:
                stale = stale or error
        if stale is not None:
            raise stale

    def authorize(
        self, peer: Identity, presented: bytes | None, right: Right, name: str, now: int
    ) -> Decision:
        """Decide whether `peer`, which presents `presented`, may use `right` on `name` now.

        Raises:
            GrantError: the subclass for what is missing or wrong.
            CAError: the peer or one of its grants is revoked, or revocations are stale.
        """
        self.check_peer(peer, now)
        if presented is None:
            raise GrantMissing(
                f"{peer.name} shows no grant to {right.label} {name}",
                (f"sign one: rossec grant sign {peer.name} --{right.label} {name}",),
            )
        grants, refusals = self._verify_all(_unpack(presented), peer, now)
        try:
            return authorize(
                grants, right, name, holder=peer.thumbprint, now=now, check=self._revocations.check
            )
        except GrantMissing:
            if refusals:  # "expired" or "forged" says more than "missing"
                raise refusals[0] from None
            raise

    def _verify_all(
        self, presented: list[bytes], peer: Identity, now: int
    ) -> tuple[list[Grant], list[GrantError]]:
        """The valid grants, and the errors of the others: one that is refused is left out."""
        grants: list[Grant] = []
        refusals: list[GrantError] = []
        for data in presented:
            try:
                grant = self._verify(data, now)
                check_one_domain(grant, "", peer.name)
                grants.append(grant)
            except GrantError as error:
                refusals.append(error)
        return grants, refusals

    def _verify(self, data: bytes, now: int) -> Grant:
        """Verify a grant once; the signature of one seen before is not checked again."""
        digest = sha256(data).digest()
        known = self._verified.get(digest)
        if known is not None and known.not_before <= now < known.expires:
            self._verified.move_to_end(digest)
            return known
        grant = self._verifier().open(data, now)
        self._verified[digest] = grant
        if len(self._verified) > CACHE_SIZE:
            self._verified.popitem(last=False)
        return grant

    def _verifier(self) -> Verifier:
        held = self._revocations.current
        return Verifier(
            self._anchor.public_key,
            self._anchor.domain,
            () if self._delegate is None else (self._delegate,),
            0 if held is None else held.seq,
            self._revocations.check,
        )


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


def _fitting(tokens: Iterable[bytes]) -> Iterator[bytes]:
    """The first of them that a header field has room for, with what CBOR adds to each."""
    room, left = MAX_PRESENTED - _ARRAY_HEAD, MAX_GRANTS
    for token in tokens:
        size = len(token) + _BYTES_HEAD
        if left and size <= room:
            room, left = room - size, left - 1
            yield token
