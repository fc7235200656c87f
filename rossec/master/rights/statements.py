"""The authority's revocations and the nodes' grants, as the master holds them. Pure.

Without a list, or with an expired one, identities may still connect (one of them may deliver a
list), but no grant is valid. Grants are stored per key, verified once, bounded in number and size.
Those of a foreign domain are verified with its key, and count for names of that domain alone.
"""

import hashlib
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

from ca.certificates import Identity, TrustAnchor
from ca.domains.aliases import REMOTE, is_alias, shown
from ca.domains.anchors import Anchors
from ca.domains.standing import Standing
from ca.errors import CAError, HintedError, RenewalRefused, Revoked
from ca.keys.signer import Signer
from ca.names import MASTER
from ca.revocation.state import Revocations, digest
from grants.errors import GrantError
from grants.model import Grant
from grants.token import Verifier, peek
from rossec.master.rights.access_rules import is_authority
from rossec.master.rights.caller import Caller, Peer
from rossec.master.rights.delegation import Delegate, discard
from rossec.master.rights.domain_trust import DomainTrust
from rossec.master.rights.grant_holder import check_holder
from rossec.master.rights.identity_renewals import IdentityRenewals, RenewalAnswer, Renewer
from rossec.master.rights.list_in_force import ListInForce
from rossec.master.rights.pertaining import entries_of, pertaining
from rossec.master.rights.presented_grants import (
    FAILURE_WINDOW,
    MAX_HELD,
    NOT_EVALUATED,
    EvaluationContext,
    Judge,
    Presented,
    PresentedGrants,
    Renewed,
)


class TrustState(ListInForce):
    """Revocations and presented grants: who is still trusted, and for what.

    Args:
        anchor: the authority, and the domain that grants must be for.
        signer: the master's own identity key; signs timestamps.
        revocations: loaded with what was persisted, if anything.
        persist: makes a list durable; called before the list takes effect.
        delegate: renews grants; by default without a delegation.
        renewer: renews identities at once; None: the authority's service does.
        persist_entries: makes the entries of a tree durable, before the tree itself.
        domains: foreign domains and their revocations; by default none is listed.
    """

    def __init__(
        self,
        anchor: TrustAnchor,
        signer: Signer,
        revocations: Revocations,
        persist: Callable[[bytes], None],
        delegate: Delegate | None = None,
        persist_entries: Callable[[bytes], None] = discard,
        renewer: Renewer | None = None,
        domains: DomainTrust | None = None,
    ) -> None:
        super().__init__(anchor, signer, revocations, persist, persist_entries)
        self.identities: Final = IdentityRenewals(anchor, renewer)
        self._delegate = Delegate(anchor, signer) if delegate is None else delegate
        self.domains: Final = domains or DomainTrust(Standing(Anchors(anchor), revocations))
        self._judge = Judge(anchor.domain, self._check_grant, self.domains.domain_of)
        self._held: dict[bytes, PresentedGrants] = {}
        self._held_by_foreigners: dict[tuple[str, bytes], PresentedGrants] = {}
        self._foreigners: dict[tuple[str, bytes], Identity] = {}  # by alias and key
        self._revoked_grants: dict[bytes, Grant] = {}
        self._identity_keys: dict[bytes, tuple[bytes, ...]] = {}  # by the identity's own key
        self._context = NOT_EVALUATED

    def caller(self, peer: Identity, now: int) -> Caller:
        """The caller with its rights now.

        Raises:
            Revoked: the key is revoked, or that of the intermediate that issued its certificate.
            CAError: of a foreigner, as `DomainTrust.check_connected`.
        """
        if not peer.certified:  # else a twin with the same key would take the place of an own node
            self._identity_keys[peer.thumbprint] = peer.keys
        if self._is_revoked(peer.keys):
            raise Revoked(
                f"the key of {shown(peer.name)} is revoked", "enroll the node with a new key"
            )
        if peer.certified:  # a foreigner
            return self._foreign_caller(peer, now)
        if not peer.wildcard and (held := self._held_by(peer)).has_tails:
            held.drop_tails()
        caller = self._caller(peer, now, self._judge, wildcard=peer.wildcard)
        if peer.name.startswith(MASTER) and self.domains.is_own_master(peer):
            return replace(caller, is_own_master=True)
        return replace(caller, is_authority=True) if is_authority(peer) else caller

    def admit(self, peer: Identity, now: int) -> None:
        """Return if `peer` may connect; raises as `caller`, or `DomainTrust.admit`."""
        self.caller(peer, now)
        if peer.is_foreign:
            self.domains.admit(peer, now)

    def _foreign_caller(self, peer: Identity, now: int) -> Caller:
        self.domains.check_connected(peer, now)
        self._foreigners[peer.name, peer.thumbprint] = peer

        def check(domain: str, entry: bytes, now: int) -> None:
            self._check_grant(domain, entry, now)
            self.domains.check_for(peer, entry, now)

        exported = self.domains.exported(peer.domain)
        return self._caller(peer, now, self._judge._replace(check=check, exported=exported))

    def _check_grant(self, domain: str, entry: bytes, now: int) -> None:
        """The own list counts for every grant here, that of its domain for a foreign one too."""
        self._revocations.check(entry, now)
        if domain != self._anchor.domain:
            self.domains.check_known(domain, entry, now)

    def caller_of(self, peer: Peer, now: int) -> Caller | None:
        """A name and key seen before, with its rights now; None: the key is revoked."""
        if not is_alias(peer.name):
            keys = self._identity_keys.get(peer.thumbprint, (peer.thumbprint,))
            return None if self._is_revoked(keys) else self._caller(peer, now, self._judge)
        foreigner = self._foreigners.get((peer.name, peer.thumbprint))
        try:
            return None if foreigner is None else self.caller(foreigner, now)
        except CAError:
            return None

    def update_domains(self, data: bytes) -> bool:
        """Take a list of domains; returns whether it differs from the one held.

        Grants of domains that are gone, or have another root, are discarded.

        Raises:
            DomainsRefused: not of the own authority, or older than one seen.
        """
        ended = self.domains.update(data)
        for held in self._held.values() if ended else ():
            held.drop_domains(ended or ())
        return ended is not None

    def present(self, caller: Caller, tokens: Sequence[bytes], now: int) -> Presented:
        """Verify and store grants; a refused one does not affect the others.

        A grant bound to another key is refused.
        """
        self._confirm(now)
        held = self._held_by(caller)
        held.drop_expired(now)
        refused: list[str] = []
        for token in tokens:
            try:
                self._add(held, caller, token, now)
            except HintedError as error:
                held.count_failure(now)
                refused.append(str(error))
        return Presented(len(held.grants), tuple(refused))

    def has_presented(self, holder: bytes, grant_id: bytes) -> bool:
        """Whether a valid or expired grant is among those that its holder has presented."""
        held = self._held.get(holder)
        return held is not None and any(each.id == grant_id for each in held.grants.values())

    def pertaining(
        self, caller: Caller, names: Iterable[str]
    ) -> Generator[None, None, frozenset[bytes]]:
        """The revoked entries that pertain to a caller, see `pertaining.pertaining`."""
        own = caller.thumbprint, self._delegate.id
        return pertaining(self._revocations.entries, self._known_grants(), own, names)

    def renew(self, caller: Caller, tokens: Sequence[bytes], now: int) -> Renewed:
        """Renewed tokens, in the same order, empty where one is refused."""
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
        return Renewed(tuple(renewed), tuple(refused))

    def renew_identity(self, caller: Caller, request: bytes, now: int) -> RenewalAnswer:
        """The renewed identity, or what is waited for; see `IdentityRenewals.ask`.

        Raises:
            CAError: the request is refused.
        """
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
        """As `Revocations.check`, against the list in force."""
        self._confirm(now)
        self._revocations.check(entry, now)

    def update_delegation(self, data: bytes) -> bool:
        """Accept a delegation to renew grants; returns whether it is newer.

        Raises:
            GrantError: not signed by the authority, or not for this master.
        """
        return self._delegate.take(data)

    def list_digests(self) -> tuple[bytes, bytes]:
        """The digests of the revocation list and of the list of domains; empty: none."""
        held = self._revocations
        own = b"" if held.current is None else digest(held.data)
        return own, self.domains.digest()

    def _list_replaced(self, before: bytes) -> bool:
        """Reset what depends on the list; returns whether it differs from `before`."""
        self._revoked_grants = {
            grant.id: grant
            for grant in self._known_grants()
            if not self._revocations.entries.isdisjoint(entries_of(grant))
        }
        self._context = NOT_EVALUATED
        return super()._list_replaced(before)

    def keep_only(self, thumbprints: frozenset[bytes], now: int) -> None:
        """Discard the grants of all other keys, and the expired grants of these."""
        self._held = {key: held for key, held in self._held.items() if key in thumbprints}
        self.held_lists.keep_only(thumbprints)
        self._identity_keys = {
            key: keys for key, keys in self._identity_keys.items() if key in thumbprints
        }
        foreign = self._held_by_foreigners
        self._held_by_foreigners = {key: foreign[key] for key in foreign if key[1] in thumbprints}
        self._foreigners = {
            key: peer for key, peer in self._foreigners.items() if key[1] in thumbprints
        }
        self.domains.keep_only(thumbprints)
        for held in (*self._held.values(), *self._held_by_foreigners.values()):
            held.drop_expired(now)

    def _is_revoked(self, keys: tuple[bytes, ...]) -> bool:
        return not self._revocations.entries.isdisjoint(keys)

    def _caller(self, peer: Peer, now: int, judge: Judge, *, wildcard: bool = False) -> Caller:
        self._confirm(now)
        return self._held_by(peer).caller(peer, self._context, judge, wildcard=wildcard)

    def _held_by(self, peer: Peer) -> PresentedGrants:
        """The grants of a key, until `keep_only` discards them.

        One key may be certified in several domains, where it is another peer.
        """
        if peer.name.startswith(REMOTE) and is_alias(peer.name):
            place = peer.name.split("/")[2], peer.thumbprint
            return self._held_by_foreigners.setdefault(place, PresentedGrants())
        held = self._held.get(peer.thumbprint)
        if held is None:
            held = self._held[peer.thumbprint] = PresentedGrants()
        return held

    def _known_grants(self) -> Iterator[Grant]:
        """The grants held, and those that the list in force has revoked."""
        yield from self._revoked_grants.values()
        for held in (*self._held.values(), *self._held_by_foreigners.values()):
            yield from held.grants.values()

    def _add(self, held: PresentedGrants, caller: Caller, token: bytes, now: int) -> None:
        key = hashlib.sha256(token).digest()
        if key in held.grants:
            return
        self._check_failures(held, now)
        if held.is_full_for(len(token)):
            raise GrantError(f"the master holds at most {MAX_HELD} grants of one node")
        grant = self._verifier_of(token, caller).open(token, now)
        check_holder(caller, grant, self.domains.label_of(grant.domain))
        held.put(token, grant)

    def _renew(self, held: PresentedGrants, caller: Caller, token: bytes, now: int) -> bytes:
        self._check_failures(held, now)
        _refuse_foreigner(caller)
        check = self._revocations.check
        grant, renewed = self._delegate.renew(
            token, caller.thumbprint, now, seq=self.number, check=check
        )
        check_holder(caller, grant, "")
        if not held.is_full_for(len(renewed)):  # else the node presents it later
            held.put(renewed, grant)
        return renewed

    @staticmethod
    def _check_failures(held: PresentedGrants, now: int) -> None:
        if held.has_failed_too_often(now):
            raise GrantError(
                "too many grants of this node were refused", f"wait {FAILURE_WINDOW} s"
            )

    def _verifier_of(self, token: bytes, caller: Caller) -> Verifier:
        """With the key of the domain the token says it is of; a foreigner has only own grants."""
        anchor, domains = self._anchor, self.domains
        if domains.anchors.all_listed and not caller.is_foreign:
            domain = peek(token).domain
            if domains.anchors.listed_domain(domain) is not None:
                return domains.verifier(domain)
        delegates = (self._signer.public_key, *domains.own_delegates())
        check = self._revocations.check
        return Verifier(anchor.public_key, anchor.domain, delegates, self.number, check)

    def _confirm(self, now: int) -> None:
        """Confirm the list to this process, once in each second and for each list."""
        context, revocations = self._context, self._revocations
        elsewhere = self.domains.generation
        if (
            context.now != now
            or context.revocations is not revocations.data
            or context.elsewhere != elsewhere
        ):
            if revocations.current is not None:
                revocations.confirm(self._timestamp(now), now)
            fresh_until = revocations.fresh_until
            self._context = EvaluationContext(now, revocations.data, fresh_until, elsewhere)


def _refuse_foreigner(caller: Caller) -> None:
    if caller.is_foreign:
        raise RenewalRefused(
            "nothing is renewed for a node of another domain", "ask the authority for a new grant"
        )
