"""The grants a node holds, and the authorization of its peers, which happens here only.

Pure: grants, revocations and `now` in; a `Decision` or an error out. Least disclosure: of the
grants this node holds, a peer receives only those that cover the request. A name may be an alias: a
right on it is the right on the origin's name, and only grants of the origin's domain prove it,
whoever holds them; what a foreign authority signs counts for nothing else. What a gateway serves
has a name of its own (`wire_names`), of this domain: only a gateway publishes under it.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import shown, split_alias
from ca.domains.served import alias_of_served, is_in_gateway
from ca.domains.standing import Standing
from ca.encoding import Value, encode
from ca.errors import CAError, NotAdmitted, RevocationsStale
from ca.revocation.state import open_timestamp
from grants.decision import Decision, authorize
from grants.errors import GrantMissing
from grants.missing_rights import grant_command, remedy, rule_form
from grants.model import MESSAGE_RIGHTS, Grant, Right
from grants.token import peek
from rossec.participant.presentation import fitting
from rossec.participant.token_opening import TokenOpener
from rossec.participant.wire_names import is_own_gateway, possible_names
from rossec.ros.names import MASTER

FIELD: Final = "rossec_grants"
_OFFERS: Final = Right.PUBLISH | Right.PROVIDE
NO_LIST: Final = (
    "the master has no revocation list yet",
    "at the authority: rossec ca refresh, then rossec ca publish; until then no peer is trusted",
)


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
    """Holds the grants of a node and checks those of its peers.

    Args:
        standing: which authorities count, and what they have revoked.
        held: the grants of this node.
        master: the certified name of its own master.
    """

    def __init__(
        self, standing: Standing, held: Iterable[bytes] = (), master: str = MASTER
    ) -> None:
        self._standing = standing
        self._revocations: Final = standing.own
        self._anchor: Final = standing.anchors.own
        self._master = master
        self._held: dict[bytes, HeldGrant] = {}
        self._tokens = TokenOpener(standing)
        for data in held:
            self.hold(data)

    @property
    def standing(self) -> Standing:
        """Which authorities count, and what they have revoked."""
        return self._standing

    def hold(self, data: bytes) -> None:
        """Add a token to those this node can present: a grant as signed, or a chain."""
        grant = peek(data)
        self._held.setdefault(grant.id, HeldGrant(grant, data, data, grant.not_before))

    def hold_renewed(self, token: bytes, now: int) -> None:
        """Replace a grant this node holds with the token the master renewed.

        Raises:
            GrantError: it is invalid, or this node does not hold the grant.
        """
        domain = peek(token).domain
        grant = self._tokens.open(token, domain, now)
        known = self._held.get(grant.id)
        if known is None:
            raise GrantMissing(f"the renewed grant {grant.short_id} is not held by this node")
        self._held[grant.id] = HeldGrant(grant, known.original, token, now)

    def held_grants(self) -> list[HeldGrant]:
        """All grants this node holds, expired ones too, except those known to be revoked."""
        own, others = self._revocations.entries, self._domains_held() - {self._anchor.domain}
        revoked = {domain: own | self._standing.revoked(domain) for domain in others}
        return [
            held
            for held in self._held.values()
            if revoked.get(held.grant.domain, own).isdisjoint(held.grant.revocable)
        ]

    def _domains_held(self) -> set[str]:
        return {held.grant.domain for held in self._held.values()}

    @property
    def foreign_domains(self) -> frozenset[str]:
        """The listed foreign domains whose grants this node holds."""
        listed = self._standing.anchors.listed_domain
        return frozenset(domain for domain in self._domains_held() if listed(domain) is not None)

    def domain_called(self, label: str) -> str | None:
        """The listed foreign domain with this label; None: there is none."""
        listed = self._standing.anchors.listed(label)
        return None if listed is None else listed.entry.domain

    @property
    def master(self) -> str:
        """The certified name of this node's own master."""
        return self._master

    def is_master(self, peer: Identity) -> bool:
        """Whether `peer` is this node's own master."""
        return peer.name == self._master and not peer.is_foreign

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
        self._tokens.own_master = master.public_key

    def expire_confirmation(self, until: int) -> None:
        """End the confirmation of every list at `until`: the clock went back."""
        self._standing.expire_confirmations(until)

    @property
    def unproved(self) -> list[bytes]:
        """Entries of a tree of revocations that wait for a proof."""
        return self._revocations.unproved

    def add_proof(self, entry: bytes, proof: bytes) -> None:
        """Take a proof. Raises `RevocationRefused`."""
        self._revocations.add_proof(entry, proof)

    def current(self, now: int) -> list[bytes]:
        """The grants that are valid now and not known to be revoked, the latest expiry first.

        Of a domain that is not listed none: nobody here could verify them.
        """
        known = {self._anchor.domain, *self.foreign_domains}
        return [held.token for held in self._current(now) if held.grant.domain in known]

    def present(self, right: Right, name: str, now: int) -> bytes:
        """Header field that proves `right` on `name`: the array of the grants that cover it.

        A peer accepts a limited number and size; those that expire last are sent.

        Raises:
            NotAdmitted, NameRefused: an alias of no domain.
        """
        covering = [held.token for held in self._covering(right, name, now)]
        return encode(list[Value](fitting(covering)))

    def holds(self, right: Right, name: str, now: int) -> bool:
        """Whether a grant this node holds covers `right` on `name` now.

        To subscribe to an alias one for what a gateway serves of it suffices.
        """
        names = possible_names(name) if right is Right.SUBSCRIBE else (name,)
        return any(self.covers(right, each, now) for each in names)

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
        """The domain whose grants decide on `name`, and the name there.

        An alias of no listed domain may be that of another master of the own one, which has only
        nodes and parameters below `/remote`: no topic and no service.

        Raises:
            NotAdmitted, NameRefused: an alias of no domain.
        """
        served = alias_of_served(name)  # by the own domain's grants, while the label is of a domain
        found = split_alias(name if served is None else served)
        if found is None:
            return self._anchor.domain, name
        label, origin = found
        listed = self._standing.anchors.listed(label)
        if listed is None and right & MESSAGE_RIGHTS:
            raise NotAdmitted(
                f"{shown(name)}: no domain is called {label} here",
                "at this side's authority: rossec domain list",
            )
        if served is not None:
            return self._anchor.domain, name
        return self._anchor.domain if listed is None else listed.entry.domain, origin

    def _current(self, now: int) -> list[HeldGrant]:
        usable = [
            held for held in self.held_grants() if held.grant.not_before <= now < held.grant.expires
        ]
        return sorted(usable, key=lambda held: held.grant.expires, reverse=True)

    def check_peer(self, peer: Identity, now: int) -> None:
        """Raise a `CAError` when `peer` is revoked, not trusted any more, or this is not known.

        See `Standing.check_peer`.
        """
        self._standing.check_peer(peer, now)

    def authorize(
        self, peer: Identity, presented: bytes | None, right: Right, name: str, now: int
    ) -> Decision:
        """Decide whether `peer`, which presents `presented`, may use `right` on `name` now.

        Raises:
            GrantError: the subclass for what is missing or wrong.
            CAError: the peer or one of its grants is revoked, or revocations are stale; or it is no
                gateway, and offers what only they do.
        """
        self.check_peer(peer, now)
        if right & _OFFERS and is_in_gateway(name) and not is_own_gateway(peer):
            verb = "publishes" if right & Right.PUBLISH else "provides"
            raise NotAdmitted(
                f"{shown(peer.name)} {verb} {name}, which only a gateway of this domain does",
                "a gateway is a node that is enrolled as /gateway or /gateway/NAME",
            )
        domain, origin = self._origin(right, name)
        if presented is None:
            raise GrantMissing(
                f"{shown(peer.name)} shows no grant to {right.label} {shown(name)}",
                remedy=_remedy(peer, right, origin),
            )
        grants, refusals = self._tokens.open_all(presented, domain, peer, now)
        check = self._tokens.check_of(domain, peer.domain)
        try:
            decision = authorize(
                grants, right, origin, holder=peer.thumbprint, now=now, check=check
            )
        except GrantMissing as error:
            if refusals:  # "expired" or "forged" says more than "missing"
                raise refusals[0] from None
            missing = GrantMissing(str(error), error.near_misses, _remedy(peer, right, origin))
            raise missing from None
        return decision if origin == name else replace(decision, name=name)


def _remedy(peer: Identity, right: Right, name: str) -> str:
    if peer.is_foreign:  # it asks its own authority for nothing of ours
        return f"sign one: {grant_command(shown(peer.name), [(right, name)])}"
    return remedy(shown(peer.name), right, rule_form(peer.name, name, wildcard=peer.wildcard))
