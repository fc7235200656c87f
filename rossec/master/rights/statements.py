"""The authority's revocations and the nodes' grants, as the master holds them. Pure.

Without a list, or with an expired one, identities may still connect (one of them may deliver a
list), but no grant is valid. Grants are stored per key, verified once, bounded in number and size.
Those of a foreign domain are verified with its key, and count for names of that domain alone. A
grant may be revoked, expire, or belong to a revoked key; `enforce` checks each registration against
the rights its node has *now*, so none of these cases needs state of its own.
"""

import hashlib
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from ca.certificates import Identity, TrustAnchor
from ca.domains import Anchors
from ca.errors import CAError, HintedError, Revoked
from ca.keys.signing import Signer
from ca.names import MASTER, REMOTE, is_alias, shown
from ca.revocation import trust_status
from grants.errors import GrantError
from grants.model import Grant, Right
from grants.token import Verifier, peek
from rossec.master.rights import access_rules, domain_trust, held_grants, revocation_lists
from rossec.master.rights.caller import Caller, CertifiedPeer
from rossec.master.rights.renewals import IdentityRenewals, RenewalAnswer, Renewer, TicketSigner
from rossec.master.state.registry import Event, Kind, NodeRef, Registry


class TrustState(revocation_lists.ListInForce):
    """Revocations and presented grants: who is still trusted, and for what."""

    # `renewer` renews identities at once; None: the authority's service does.
    def __init__(
        self,
        anchor: TrustAnchor,
        signer: Signer,
        revocations: trust_status.Revocations,
        persist: Callable[[bytes], None],
        delegate: TicketSigner | None = None,
        persist_entries: Callable[[bytes], object] = lambda _data: None,
        renewer: Renewer | None = None,
        domains: domain_trust.DomainTrust | None = None,
    ) -> None:
        super().__init__(anchor, signer, revocations, persist, persist_entries)
        self.identities: Final = IdentityRenewals(anchor, renewer)
        self._delegate = TicketSigner(anchor, signer) if delegate is None else delegate
        self.domains: Final = domains or domain_trust.DomainTrust(
            trust_status.TrustStatus(Anchors(anchor), revocations)
        )
        self._judge = held_grants.Judge(anchor.domain, self._check_grant, self.domains.domain_of)
        self._held: dict[bytes, held_grants.PresentedGrants] = {}
        self._held_by_foreigners: dict[tuple[str, bytes], held_grants.PresentedGrants] = {}
        self._foreigners: dict[tuple[str, bytes], Identity] = {}  # by alias and key
        self._revoked_grants: dict[bytes, Grant] = {}
        self._identity_keys: dict[bytes, tuple[bytes, ...]] = {}  # by the identity's own key
        self._context = held_grants.NOT_EVALUATED

    def caller(self, peer: Identity, now: int) -> Caller:
        if not peer.certified:  # else a twin with the same key would take the place of an own node
            self._identity_keys[peer.thumbprint] = peer.keys
        if self._is_revoked(peer.keys):
            raise Revoked(f"the key of {shown(peer.name)} is revoked", "enroll the node with a new key")
        if peer.certified:  # a foreigner
            self.domains.check_connected(peer, now)
            self._foreigners[peer.name, peer.thumbprint] = peer

            def check(domain: str, entry: bytes, now: int) -> None:
                self._check_grant(domain, entry, now)
                self.domains.check_for(peer, entry, now)

            exported = self.domains.exported(peer.domain)
            return self._caller(peer, now, self._judge._replace(check=check, exported=exported))
        if not peer.wildcard and (held := self._held_by(peer)).has_tails:
            # Patterns of tails are of a wildcard certificate; another one may have the same key.
            held.drop(lambda grant: grant.has_tail_patterns)
            held.has_tails = False
        caller = self._caller(peer, now, self._judge, wildcard=peer.wildcard)
        if peer.name.startswith(MASTER) and self.domains.is_own_master(peer):
            return replace(caller, is_own_master=True)
        return replace(caller, is_authority=True) if access_rules.is_authority(peer) else caller

    def admit(self, peer: Identity, now: int) -> None:
        """Return if `peer` may connect; raises as `caller`, or `DomainTrust.admit`."""
        self.caller(peer, now)
        if peer.is_foreign:
            self.domains.admit(peer, now)

    def _check_grant(self, domain: str, entry: bytes, now: int) -> None:
        self._revocations.check(entry, now)
        if domain != self._anchor.domain:
            self.domains.check_known(domain, entry, now)

    def caller_of(self, peer: CertifiedPeer, now: int) -> Caller | None:
        # A name and key seen before; None: the key is revoked.
        if not is_alias(peer.name):
            keys = self._identity_keys.get(peer.thumbprint, (peer.thumbprint,))
            return None if self._is_revoked(keys) else self._caller(peer, now, self._judge)
        foreigner = self._foreigners.get((peer.name, peer.thumbprint))
        try:
            return None if foreigner is None else self.caller(foreigner, now)
        except CAError:
            return None

    def update_domains(self, data: bytes) -> bool:
        # Whether it differs from the one held; grants of domains that are gone are discarded.
        ended = self.domains.update(data)
        for held in self._held.values() if ended else ():
            held.drop(lambda grant: grant.domain in (ended or ()))
        return ended is not None

    def present(self, caller: Caller, tokens: Sequence[bytes], now: int) -> held_grants.VerifiedGrants:
        # A refused grant does not affect the others; one bound to another key is refused.
        self._confirm(now)
        held, domains = self._held_by(caller), self.domains
        held.drop_expired(now)
        refused: list[str] = []
        for token in tokens:
            try:
                if hashlib.sha256(token).digest() in held.grants:
                    continue
                # 1. What costs nothing first: a verification costs the loop a signature.
                self._check_failures(held, now)
                if held.is_full_for(len(token)):
                    raise GrantError(f"the master holds at most {held_grants.MAX_HELD} grants of one node")
                # 2. With the key of the domain the token says it is of; a foreigner has only own grants.
                domain = peek(token).domain if domains.anchors.all_listed and not caller.is_foreign else ""
                if domain and domains.anchors.listed_domain(domain) is not None:
                    verifier = domains.verifier(domain)
                else:
                    delegates = (self._signer.public_key, *domains.own_delegates())
                    check, own = self._revocations.check, self._anchor
                    verifier = Verifier(own.public_key, own.domain, delegates, self.number, check)
                grant = verifier.open(token, now)
                # 3. It is the caller's own.
                held_grants.check_holder(caller, grant, domains.label_of(grant.domain))
                held.put(token, grant)
            except HintedError as error:
                held.count_failure(now)
                refused.append(str(error))
        return held_grants.VerifiedGrants(len(held.grants), tuple(refused))

    def has_presented(self, holder: bytes, grant_id: bytes) -> bool:
        held = self._held.get(holder)
        return held is not None and any(each.id == grant_id for each in held.grants.values())

    def pertaining(self, caller: Caller, names: Iterable[str]) -> Generator[None, None, frozenset[bytes]]:
        own = caller.thumbprint, self._delegate.id
        return revocation_lists.pertaining(self._revocations.entries, self._known_grants(), own, names)

    def renew(self, caller: Caller, tokens: Sequence[bytes], now: int) -> held_grants.Renewed:
        # In the same order, empty where one is refused.
        self._confirm(now)
        held = self._held_by(caller)
        held.drop_expired(now)
        renewed: list[bytes] = []
        refused: list[str] = []
        for token in tokens:
            try:
                renewed.append(self._renew(held, caller, token, now))
            except HintedError as error:
                held.count_failure(now)
                refused.append(str(error))
                renewed.append(b"")
        return held_grants.Renewed(tuple(renewed), tuple(refused))

    def renew_identity(self, caller: Caller, request: bytes, now: int) -> RenewalAnswer:
        self._confirm(now)
        held = self._held_by(caller)
        self._check_failures(held, now)
        try:
            _refuse_foreigner(caller)
            check = self._revocations.check
            return self.identities.ask(caller.thumbprint, request, now, check)
        except HintedError:
            held.count_failure(now)
            raise

    def check(self, entry: bytes, now: int) -> None:
        self._confirm(now)
        self._revocations.check(entry, now)

    def update_delegation(self, data: bytes) -> bool:
        return self._delegate.take(data)

    def list_digests(self) -> tuple[bytes, bytes]:
        held = self._revocations
        own = b"" if held.current is None else held.digest
        return own, self.domains.digest()

    def _list_replaced(self, before: bytes) -> bool:
        self._revoked_grants = {
            grant.id: grant
            for grant in self._known_grants()
            if not self._revocations.entries.isdisjoint(revocation_lists.entries_of(grant))
        }
        self._context = held_grants.NOT_EVALUATED
        return super()._list_replaced(before)

    def keep_only(self, thumbprints: frozenset[bytes], now: int) -> None:
        # Discard all that is known of other keys, and the expired grants of these.
        self._held = {key: held for key, held in self._held.items() if key in thumbprints}
        self.held_lists.keep_only(thumbprints)
        self._identity_keys = {key: keys for key, keys in self._identity_keys.items() if key in thumbprints}
        foreign = self._held_by_foreigners
        self._held_by_foreigners = {key: foreign[key] for key in foreign if key[1] in thumbprints}
        self._foreigners = {key: peer for key, peer in self._foreigners.items() if key[1] in thumbprints}
        self.domains.keep_only(thumbprints)
        for held in (*self._held.values(), *self._held_by_foreigners.values()):
            held.drop_expired(now)

    def _is_revoked(self, keys: tuple[bytes, ...]) -> bool:
        return not self._revocations.entries.isdisjoint(keys)

    def _caller(
        self, peer: CertifiedPeer, now: int, judge: held_grants.Judge, *, wildcard: bool = False
    ) -> Caller:
        self._confirm(now)
        return self._held_by(peer).caller(peer, self._context, judge, wildcard=wildcard)

    def _held_by(self, peer: CertifiedPeer) -> held_grants.PresentedGrants:
        # The grants of a key, until `keep_only` discards them.
        # One key may be certified in several domains, where it is another peer.
        if peer.name.startswith(REMOTE) and is_alias(peer.name):
            place = peer.name.split("/")[2], peer.thumbprint
            return self._held_by_foreigners.setdefault(place, held_grants.PresentedGrants())
        held = self._held.get(peer.thumbprint)
        if held is None:
            held = self._held[peer.thumbprint] = held_grants.PresentedGrants()
        return held

    def _known_grants(self) -> Iterator[Grant]:
        yield from self._revoked_grants.values()
        for held in (*self._held.values(), *self._held_by_foreigners.values()):
            yield from held.grants.values()

    def _renew(self, held: held_grants.PresentedGrants, caller: Caller, token: bytes, now: int) -> bytes:
        self._check_failures(held, now)
        _refuse_foreigner(caller)
        check = self._revocations.check
        grant, renewed = self._delegate.renew(token, caller.thumbprint, now, seq=self.number, check=check)
        held_grants.check_holder(caller, grant, "")
        if not held.is_full_for(len(renewed)):  # else the node presents it later
            held.put(renewed, grant)
        return renewed

    @staticmethod
    def _check_failures(held: held_grants.PresentedGrants, now: int) -> None:
        if held.has_failed_too_often(now):
            raise GrantError(
                "too many grants of this node were refused", f"wait {held_grants.FAILURE_WINDOW} s"
            )

    def _confirm(self, now: int) -> None:
        held, revocations, elsewhere = self._context, self._revocations, self.domains.generation
        if held.now != now or held.revocations is not revocations.data or held.elsewhere != elsewhere:
            if revocations.current is not None:
                revocations.confirm(self._timestamp(now), now)
            self._context = held_grants.EvaluationContext(
                now, revocations.data, revocations.fresh_until, elsewhere
            )


def _refuse_foreigner(caller: Caller) -> None:
    if caller.is_foreign:
        raise CAError("nothing is renewed for a node of another domain", "ask the authority for a new grant")


_REQUIRED_RIGHTS: Final = {Kind.PUBLISHER: Right.PUBLISH, Kind.SERVICE: Right.PROVIDE}
BATCH: Final = 64  # registrations checked in one step, which the loop waits for


class EnforcementStep(NamedTuple):
    node: NodeRef
    kind: Kind
    keys: tuple[str, ...]


def enforcement_steps(registry: Registry) -> list[EnforcementStep]:
    # Calls may be answered between two steps.
    return [
        EnforcementStep(node, kind, keys[begin : begin + BATCH])
        for node in registry.nodes()
        for kind in Kind
        for keys in (registry.keys_of(node.name, kind),)
        for begin in range(0, len(keys), BATCH)
    ]


def enforce(registry: Registry, trust: TrustState, step: EnforcementStep, now: int) -> list[Event]:
    """Remove the registrations of `step` that no right covers; returns the events to deliver."""
    if not registry.is_current(step.node):
        return []
    caller = trust.caller_of(step.node, now)
    if caller is None:
        return [*registry.remove_node(step.node.name)]
    match step.kind:
        case Kind.PARAMETER:  # something at or below its key; each update is authorized again anyway
            allowed = [caller.may_some_below(Right.PARAM_GET, k.removesuffix("/") or "/") for k in step.keys]
        case Kind.SUBSCRIBER:
            allowed = [access_rules.may_subscribe(caller, key) for key in step.keys]
        case kind:
            allowed = [caller.may(_REQUIRED_RIGHTS[kind], key) for key in step.keys]
    uncovered = [key for key, is_allowed in zip(step.keys, allowed, strict=True) if not is_allowed]
    return [event for key in uncovered for event in registry.remove(step.kind, key, caller.name)]
