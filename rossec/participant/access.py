"""The grants a node holds, and the authorization of its peers, which happens here only.

Pure: grants, revocations and `now` in; a `Decision` or an error out. Least disclosure: of the grants this
node holds, a peer receives only those that cover the request. A name may be an alias: a right on it is the
right on the origin's name, and only grants of the origin's domain prove it, whoever holds them; what a
foreign authority signs counts for nothing else. What a gateway serves has a name of its own, of this domain:
only a gateway publishes under it. Which domain a token must be of is the caller's to say, from the name that
is asked for; never the token's.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Final, Protocol

from cryptography.hazmat.primitives.asymmetric import ec

from ca import names
from ca.bounded import Newest
from ca.certificates import Identity, TrustAnchor
from ca.encoding import Value, decode, encode
from ca.errors import CAError, EncodingError, NameRefused, NotAdmitted, RevocationsStale
from ca.revocation.lists import open_timestamp
from ca.revocation.trust_status import TrustStatus
from grants.decision import Decision, RevocationCheck, authorize, check_tail
from grants.errors import GrantError, GrantMalformed, GrantMissing
from grants.model import MESSAGE_RIGHTS, Grant, Right
from grants.request import grant_command, remedy, rule_form
from grants.token import Verifier, check_one_domain, peek
from rossec.ros.names import MASTER

MAX_PRESENTED: Final = 40 * 1024  # a header field holds 48 KiB
MAX_GRANTS: Final = 16
MAX_CALL: Final = 64  # tokens; the master stores this many of one node
MAX_CALL_BYTES: Final = 512 * 1024  # a body has 1 MiB, and base64 takes a third more
CACHE_SIZE: Final = 1024
FIELD: Final = "rossec_grants"
NO_LIST: Final = (
    "the master has no revocation list yet",
    "at the authority: rossec ca refresh, then rossec ca publish; until then no peer is trusted",
)
_ARRAY_HEAD, _BYTES_HEAD = 3, 5  # at most, in CBOR
Persist = Callable[[bytes], None]  # stores a list; durable when it returns
_OFFERS: Final = Right.PUBLISH | Right.PROVIDE


def is_own_gateway(peer: Identity) -> bool:
    """Whether `peer` is a gateway of the own domain; a name with a tail is none."""
    return names.is_gateway(peer.name) and not peer.is_foreign and not peer.wildcard


def granted_name(peer: Identity, topic: str, own: str = "") -> str:
    """The local name whose grants decide on the subscribed `topic` with the publisher `peer`.

    A subscriber of the alias `/remote/hospital/pose` is told addresses by its master; who is there, and so
    which of two names counts, only the authenticated peer decides. A gateway of the own domain serves the
    topic as `/gateway/hospital/pose`, on the wire and in its grants; to every other peer the alias is the
    origin's name, by the origin's grants. So neither authority's grants count for what the other one's are
    about.
    `own`: the certified name of this node, if it may be a gateway. To a gateway an alias is the origin's
        alone: it
            could be led to forward what it serves itself.
    """
    served = names.is_alias(topic) and is_own_gateway(peer) and not names.is_gateway(own)
    return names.served_name(topic) if served else topic


def wire_name(peer: Identity, topic: str, own: str = "") -> str:
    """The name by which `peer` is asked for the subscribed `topic`; `own` as of `granted_name`."""
    return names.origin_of(granted_name(peer, topic, own))


def possible_names(topic: str) -> tuple[str, ...]:
    """The names of which one must be granted to subscribe to `topic` at all."""
    try:
        return (topic, names.served_name(topic)) if names.is_alias(topic) else (topic,)
    except NameRefused:
        return (topic,)


class TokenOpener:
    """Verifies tokens, each once, by the root, the list and the masters of one domain. `own_master`: the key
    of the node's own master, which may renew grants of the own domain."""

    def __init__(self, trust_status: TrustStatus) -> None:
        self._trust_status = trust_status
        self._own: Final = trust_status.anchors.own
        self._opened: Newest[tuple[bytes, bytes], Grant] = Newest(CACHE_SIZE)
        self.own_master: ec.EllipticCurvePublicKey | None = None

    def open_all(
        self, presented: bytes, domain: str, peer: Identity, now: int
    ) -> tuple[list[Grant], list[GrantError]]:
        grants: list[Grant] = []
        refusals: list[GrantError] = []
        listed = None if domain == self._own.domain else self._trust_status.anchors.listed_domain(domain)
        label = "" if listed is None else listed.entry.label
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
        is_own = domain == self._own.domain
        revocations = self._trust_status.own if is_own else self._trust_status.foreign(domain)
        held = None if revocations is None else revocations.current
        mine = (self.own_master,) if is_own and self.own_master is not None else ()
        verifier = Verifier(
            self._root(domain).public_key,
            domain,
            (*mine, *self._trust_status.delegates(domain)),
            0 if held is None else held.seq,
            self.check_of(domain),
        )
        return verifier.open(data, now)

    def check_of(self, *domains: str) -> RevocationCheck:
        foreign = dict.fromkeys(domain for domain in domains if domain != self._own.domain)
        if not foreign:
            return self._trust_status.own.check

        def check(entry: bytes, now: int) -> None:
            self._trust_status.own.check(entry, now)
            for domain in foreign:
                self._trust_status.check(domain, entry, now)

        return check

    def _open_once(self, data: bytes, domain: str, now: int) -> Grant:
        # As `open`; the signature of one seen before is not checked again.
        # By its root, too: under another one it is verified anew.
        seen = self._root(domain).thumbprint, sha256(data).digest()
        known = self._opened.use(seen)
        if known is not None and known.not_before <= now < known.expires:
            return known
        grant = self._opened[seen] = self.open(data, domain, now)
        return grant

    def _root(self, domain: str) -> TrustAnchor:
        if domain == self._own.domain:
            return self._own
        listed = self._trust_status.anchors.listed_domain(domain)
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


# How many tokens are shown at once: what a peer that has not judged them yet may be sent. A chain of
# narrowings may be as large as a few dozen grants, so the bytes count as well as the number.


def fitting(tokens: Iterable[bytes]) -> Iterator[bytes]:
    room, left = MAX_PRESENTED - _ARRAY_HEAD, MAX_GRANTS
    for token in tokens:
        size = len(token) + _BYTES_HEAD
        if left and size <= room:
            room, left = room - size, left - 1
            yield token


def batches(tokens: Iterable[bytes]) -> Iterator[list[bytes]]:
    """The tokens in calls to the master: each at most `MAX_CALL` of them and `MAX_CALL_BYTES`."""
    batch: list[bytes] = []
    size = 0
    for token in tokens:
        if batch and (len(batch) == MAX_CALL or size + len(token) > MAX_CALL_BYTES):
            yield batch
            batch, size = [], 0
        batch.append(token)
        size += len(token)
    if batch:
        yield batch


@dataclass(frozen=True)
class HeldGrant:
    grant: Grant  # its content; `expires` as renewed
    original: bytes  # what the authority signed
    token: bytes  # what is presented
    since: int  # when it was last renewed, or becomes valid


class Access:
    """Holds the grants of a node and checks those of its peers; `master`: its own one's certified name."""

    def __init__(self, trust_status: TrustStatus, held: Iterable[bytes] = (), master: str = MASTER) -> None:
        self.trust_status = trust_status
        self._revocations: Final = trust_status.own
        self._anchor: Final = trust_status.anchors.own
        self.master = master
        self._held: dict[bytes, HeldGrant] = {}
        self._tokens = TokenOpener(trust_status)
        for data in held:
            self.hold(data)

    def hold(self, data: bytes) -> None:
        grant = peek(data)
        self._held.setdefault(grant.id, HeldGrant(grant, data, data, grant.not_before))

    def hold_renewed(self, token: bytes, now: int) -> None:
        """Replace a grant this node holds with the token the master renewed."""
        domain = peek(token).domain
        grant = self._tokens.open(token, domain, now)
        known = self._held.get(grant.id)
        if known is None:
            raise GrantMissing(f"the renewed grant {grant.short_id} is not held by this node")
        self._held[grant.id] = HeldGrant(grant, known.original, token, now)

    def held_grants(self) -> list[HeldGrant]:
        """All grants this node holds, expired ones too, except those known to be revoked."""
        own, others = self._revocations.entries, self._domains_held() - {self._anchor.domain}
        # A foreign grant is ended by either authority's list (attack `foreign-node`).
        revoked = {domain: own | self.trust_status.revoked(domain) for domain in others}
        return [
            held
            for held in self._held.values()
            if revoked.get(held.grant.domain, own).isdisjoint(held.grant.revocable)
        ]

    def _domains_held(self) -> set[str]:
        return {held.grant.domain for held in self._held.values()}

    @property
    def foreign_domains(self) -> frozenset[str]:
        listed = self.trust_status.anchors.listed_domain
        return frozenset(domain for domain in self._domains_held() if listed(domain) is not None)

    def domain_called(self, label: str) -> str | None:
        listed = self.trust_status.anchors.listed(label)
        return None if listed is None else listed.entry.domain

    def is_master(self, peer: Identity) -> bool:
        return peer.name == self.master and not peer.is_foreign

    @property
    def epoch(self) -> int:
        held = self._revocations.current
        return 0 if held is None else held.epoch

    def update_revocations(
        self, revocations: bytes, timestamp: bytes, master: Identity, now: int, persist: Persist
    ) -> None:
        """Take over a newer list (empty: the one held is the newest) and its timestamp. A valid list is kept
        even when the timestamp is not accepted."""
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
        # Last: a master that was refused above may renew no grant.
        self._tokens.own_master = master.public_key

    def expire_confirmation(self, until: int) -> None:
        self.trust_status.expire_confirmations(until)

    @property
    def unproved(self) -> list[bytes]:
        return self._revocations.unproved

    def add_proof(self, entry: bytes, proof: bytes) -> None:
        self._revocations.add_proof(entry, proof)

    def current(self, now: int) -> list[bytes]:
        """The grants that are valid now and not known to be revoked, the latest expiry first. Of a domain
        that is not listed none: nobody here could verify them."""
        known = {self._anchor.domain, *self.foreign_domains}
        return [held.token for held in self._current(now) if held.grant.domain in known]

    def present(self, right: Right, name: str, now: int) -> bytes:
        """Header field that proves `right` on `name`: the array of the grants that cover it. A peer accepts a
        limited number and size; those that expire last are sent."""
        covering = [held.token for held in self._covering(right, name, now)]
        return encode(list[Value](fitting(covering)))

    def holds(self, right: Right, name: str, now: int) -> bool:
        """Whether a grant this node holds covers `right` on `name` now. To subscribe to an alias one for what
        a gateway serves of it suffices."""
        possible = possible_names(name) if right is Right.SUBSCRIBE else (name,)
        return any(self.covers(right, each, now) for each in possible)

    def covers(self, right: Right, name: str, now: int) -> bool:
        """As `holds`, by that name alone: on an alias only a grant of its origin counts."""
        try:
            return bool(self._covering(right, name, now))
        except CAError:
            return False

    def _covering(self, right: Right, name: str, now: int) -> list[HeldGrant]:
        domain, origin = self._origin(right, name)
        return [
            held
            for held in self._current(now)
            if held.grant.domain == domain and held.grant.covers(right, origin)
        ]

    def _origin(self, right: Right, name: str) -> tuple[str, str]:
        # An alias of no listed domain may be that of another master of the own one, which has only nodes and
        # parameters below `/remote`: no topic and no service.
        served = names.alias_of_served(name)  # by the own domain's grants, while the label is of a domain
        found = names.split_alias(name if served is None else served)
        if found is None:
            return self._anchor.domain, name
        label, origin = found
        listed = self.trust_status.anchors.listed(label)
        if listed is None and right & MESSAGE_RIGHTS:
            raise NotAdmitted(
                f"{names.shown(name)}: no domain is called {label} here",
                "at this side's authority: rossec domain list",
            )
        if served is not None:
            return self._anchor.domain, name
        return self._anchor.domain if listed is None else listed.entry.domain, origin

    def _current(self, now: int) -> list[HeldGrant]:
        usable = [held for held in self.held_grants() if held.grant.not_before <= now < held.grant.expires]
        return sorted(usable, key=lambda held: held.grant.expires, reverse=True)

    def check_peer(self, peer: Identity, now: int) -> None:
        """Raise a `CAError` when `peer` is revoked, not trusted any more, or this is not known."""
        self.trust_status.check_peer(peer, now)

    def authorize(
        self, peer: Identity, presented: bytes | None, right: Right, name: str, now: int
    ) -> Decision:
        """Decide whether `peer`, which presents `presented`, may use `right` on `name` now."""
        # 1. The peer itself: of a revoked one nothing is opened.
        self.check_peer(peer, now)
        # 2. What only gateways offer, whatever a grant says.
        if right & _OFFERS and names.is_in_gateway(name) and not is_own_gateway(peer):
            verb = "publishes" if right & Right.PUBLISH else "provides"
            raise NotAdmitted(
                f"{names.shown(peer.name)} {verb} {name}, which only a gateway of this domain does",
                "a gateway is a node that is enrolled as /gateway or /gateway/NAME",
            )
        # 3. Whose grants count, and by which name: an alias is of its origin's domain.
        domain, origin = self._origin(right, name)
        if presented is None:
            raise GrantMissing(
                f"{names.shown(peer.name)} shows no grant to {right.label} {names.shown(name)}",
                remedy=_remedy(peer, right, origin),
            )
        # 4. Each token for itself: one that is invalid takes nothing from the others.
        grants, refusals = self._tokens.open_all(presented, domain, peer, now)
        check = self._tokens.check_of(domain, peer.domain)
        # 5. The decision, by what is left: for this key, this right and this name.
        try:
            decision = authorize(grants, right, origin, holder=peer.thumbprint, now=now, check=check)
        except GrantMissing as error:
            if refusals:  # "expired" or "forged" says more than "missing"
                raise refusals[0] from None
            missing = GrantMissing(str(error), error.near_misses, _remedy(peer, right, origin))
            raise missing from None
        return decision if origin == name else replace(decision, name=name)


def _remedy(peer: Identity, right: Right, name: str) -> str:
    if peer.is_foreign:  # it asks its own authority for nothing of ours
        return f"sign one: {grant_command(names.shown(peer.name), [(right, name)])}"
    return remedy(names.shown(peer.name), right, rule_form(peer.name, name, wildcard=peer.wildcard))


# The parts of `Access` that others use: a program with threads passes an object with a lock.


class HandshakeAccess(Protocol):
    def present(self, right: Right, name: str, now: int) -> bytes: ...
    def is_master(self, peer: Identity) -> bool: ...
    def check_peer(self, peer: Identity, now: int) -> None: ...

    def authorize(
        self, peer: Identity, presented: bytes | None, right: Right, name: str, now: int
    ) -> Decision: ...


class MembershipAccess(HandshakeAccess, Protocol):
    @property
    def epoch(self) -> int: ...
    @property
    def foreign_domains(self) -> frozenset[str]: ...
    @property
    def unproved(self) -> list[bytes]: ...
    def hold(self, data: bytes) -> None: ...
    def hold_renewed(self, token: bytes, now: int) -> None: ...
    def held_grants(self) -> list[HeldGrant]: ...
    def current(self, now: int) -> list[bytes]: ...
    def add_proof(self, entry: bytes, proof: bytes) -> None: ...
    def expire_confirmation(self, until: int) -> None: ...

    def update_revocations(
        self, revocations: bytes, timestamp: bytes, master: Identity, now: int, persist: Persist
    ) -> None: ...
