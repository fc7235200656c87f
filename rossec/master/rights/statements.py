"""The authority's revocations and the nodes' grants, as the master holds them. Pure.

The master is its own source of freshness: it confirms the list it holds, and signs the timestamps
that prove to nodes that no newer list is being withheld. Without a list, or with an expired one,
identities may still connect (one of them may deliver a list), but no grant is valid. Grants are
stored per key, verified once, bounded in number and size.
"""

import hashlib
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

from ca.certificates import Identity, TrustAnchor
from ca.errors import HintedError, RenewalRefused, RevocationRefused, Revoked
from ca.keys.signer import Signer
from ca.revocation.state import MAX_AGE, Revocations, Timestamp, digest, sign_timestamp
from ca.revocation.tree import TreeEntries, is_tree, open_tree
from grants.decision import RevocationCheck
from grants.errors import GrantError, GrantNotHeld
from grants.model import Grant
from grants.narrowing import check_one_domain
from grants.token import Verifier
from rossec.master.rights.access_rules import is_authority
from rossec.master.rights.caller import Caller, Peer
from rossec.master.rights.delegation import Delegate, discard
from rossec.master.rights.held_lists import HeldLists, ListStanding
from rossec.master.rights.presented_grants import (
    FAILURE_WINDOW,
    MAX_HELD,
    NOT_EVALUATED,
    EvaluationContext,
    Presented,
    PresentedGrants,
    Renewed,
)

_PUBLISH: Final = "deliver it with: rossec ca publish"


Renewer = Callable[[bytes, int, RevocationCheck], bytes]
"""Answers a renewal request (`ca.renewal`) with the node's new bundle."""


class TrustState:
    """Revocations and presented grants: who is still trusted, and for what.

    Args:
        anchor: the authority, and the domain that grants must be for.
        signer: the master's own identity key; signs timestamps.
        revocations: loaded with what was persisted, if anything.
        persist: makes a list durable; called before the list takes effect.
        delegate: renews grants; by default without a delegation.
        renewer: renews identities; None: this master renews none.
        persist_entries: makes the entries of a tree durable, before the tree itself.
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
    ) -> None:
        self._anchor = anchor
        self._signer = signer
        self._revocations = revocations
        self._persist = persist
        self._persist_entries = persist_entries
        self._renewer = renewer
        self._listing: TreeEntries | None = None
        self._delegate = Delegate(anchor, signer) if delegate is None else delegate
        self._held: dict[bytes, PresentedGrants] = {}
        self._revoked_grants: dict[bytes, Grant] = {}
        self.held_lists = HeldLists()
        self._identity_keys: dict[bytes, tuple[bytes, ...]] = {}  # by the identity's own key
        self._timestamp_cache: tuple[int, bytes] = (-1, b"")
        self._context = NOT_EVALUATED

    def caller(self, peer: Identity, now: int) -> Caller:
        """The caller with its rights now.

        Raises:
            Revoked: the key is revoked, or that of the intermediate that issued its certificate.
        """
        keys = self._identity_keys[peer.thumbprint] = peer.keys
        if self._is_revoked(keys):
            raise Revoked(f"the key of {peer.name} is revoked", "enroll the node with a new key")
        caller = self._caller(peer, now, wildcard=peer.wildcard)
        return replace(caller, is_authority=True) if is_authority(peer) else caller

    def caller_of(self, peer: Peer, now: int) -> Caller | None:
        """A name and key seen before, with its rights now; None: the key is revoked."""
        if self._is_revoked(self._identity_keys.get(peer.thumbprint, (peer.thumbprint,))):
            return None
        return self._caller(peer, now)

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

    def revoked(self) -> frozenset[bytes]:
        """All revoked entries."""
        return self._revocations.entries

    def pertaining(
        self, caller: Caller, names: Iterable[str]
    ) -> Generator[None, None, frozenset[bytes]]:
        """The revoked entries that pertain to a caller that is registered for `names`.

        Its own grants; grants of any holder for these names, and the keys of these holders; the
        delegation of renewal. Only grants that were presented to the master are considered: it
        does not know the others. Yields where other calls may be answered.
        """
        keys, entries = frozenset(names), self._revocations.entries
        pertaining = {caller.thumbprint, self._delegate.id}
        revoked = [item for item in self._known_grants() if not entries.isdisjoint(_entries(item))]
        for grant in revoked:
            if grant.holder == caller.thumbprint or (yield from _names_any(grant, keys)):
                pertaining |= _entries(grant)
        return entries & pertaining

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

    def renew_identity(self, caller: Caller, request: bytes, now: int) -> bytes:
        """The bundle of a renewed identity, signed by the intermediate of this host.

        Raises:
            CAError: the request is refused, or there is no intermediate here.
        """
        if self._renewer is None:
            raise RenewalRefused("this master renews no identities", "ask the authority's operator")
        self._confirm(now)
        held = self._held_by(caller)
        self._check_failures(held, now)
        try:
            return self._renewer(request, now, self._revocations.check)
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

    def current(self, now: int) -> tuple[bytes, bytes]:
        """The list and a timestamp of this second; empty while there is no list."""
        revocations = self._revocations.current
        if revocations is None:
            return b"", b""
        if self._timestamp_cache[0] != now:
            self._timestamp_cache = now, sign_timestamp(self._signer, self._timestamp(now))
        return self._revocations.data, self._timestamp_cache[1]

    def revocations_for(self, peer: Peer, now: int) -> tuple[bytes, bytes]:
        """As `current`, but without the list if the node has said that it holds it."""
        data, stamp = self.current(now)
        return (b"" if self.held_lists.holds(peer, digest(data)) else data), stamp

    def standing(self, connected: Iterable[Peer], now: int) -> ListStanding:
        """How many of the `connected` hold the list in force."""
        return self.held_lists.standing(connected, digest(self._revocations.data), now)

    def list_digests(self) -> tuple[bytes, bytes]:
        """The digests of the revocation list and of the list of domains; empty: none."""
        held = self._revocations
        return b"" if held.current is None else digest(held.data), b""

    @property
    def list_number(self) -> tuple[int, int]:
        """Epoch and sequence number of the list in force; zeros: none."""
        current = self._revocations.current
        return (0, 0) if current is None else current.number

    @property
    def number(self) -> int:
        """Sequence number of the list in force; 0: none."""
        return 0 if self._revocations.current is None else self._revocations.current.seq

    def update(self, data: bytes, now: int) -> bool:
        """Accept a list signed by the authority; returns whether it differs from the one held.

        Raises:
            RevocationRefused: forged, malformed, or older than one seen.
        """
        if is_tree(data):
            raise RevocationRefused("a revocation tree needs its entries", _PUBLISH)
        before = self._revocations.data
        self._revocations.update(data, now, self._persist)
        self._listing = None
        return self._list_replaced(before)

    def update_tree(self, data: bytes, entries: bytes, now: int) -> bool:
        """Accept a tree signed by the authority, with all its entries; as `update`."""
        signed = open_tree(data, self._anchor.public_key)  # first: the sender may be unauthorized
        listing = TreeEntries.read(entries)
        listing.check(signed)
        before = self._revocations.data

        def persist(data: bytes) -> None:
            self._persist_entries(entries)
            self._persist(data)

        if data == before:  # after a restart without the entries
            self._persist_entries(entries)
        self._revocations.update(data, now, persist)
        self._revocations.set_entries(listing)
        self._listing = listing
        return self._list_replaced(before)

    def proofs(self, entries: Sequence[bytes]) -> list[bytes]:
        """The proof of each entry in the tree in force; empty while a list is in force."""
        return [] if self._listing is None else [self._listing.prove(item) for item in entries]

    def _list_replaced(self, before: bytes) -> bool:
        """Reset what depends on the list; returns whether it differs from `before`."""
        self._revoked_grants = {
            grant.id: grant
            for grant in self._known_grants()
            if not self._revocations.entries.isdisjoint(_entries(grant))
        }
        self._timestamp_cache, self._context = (-1, b""), NOT_EVALUATED
        return self._revocations.data != before

    def keep_only(self, thumbprints: frozenset[bytes], now: int) -> None:
        """Discard the grants of all other keys, and the expired grants of these."""
        self._held = {key: held for key, held in self._held.items() if key in thumbprints}
        self.held_lists.keep_only(thumbprints)
        self._identity_keys = {
            key: keys for key, keys in self._identity_keys.items() if key in thumbprints
        }
        for held in self._held.values():
            held.drop_expired(now)

    def _is_revoked(self, keys: tuple[bytes, ...]) -> bool:
        return not self._revocations.entries.isdisjoint(keys)

    def _caller(self, peer: Peer, now: int, *, wildcard: bool = False) -> Caller:
        self._confirm(now)
        return self._held_by(peer).caller(peer, self._context, self._revocations, wildcard=wildcard)

    def _held_by(self, peer: Peer) -> PresentedGrants:
        """The grants of a key, until `keep_only` discards them."""
        held = self._held.get(peer.thumbprint)
        if held is None:
            held = self._held[peer.thumbprint] = PresentedGrants()
        return held

    def _known_grants(self) -> Iterator[Grant]:
        """The grants held, and those that the list in force has revoked."""
        yield from self._revoked_grants.values()
        for held in self._held.values():
            yield from held.grants.values()

    def _add(self, held: PresentedGrants, caller: Caller, token: bytes, now: int) -> None:
        key = hashlib.sha256(token).digest()
        if key in held.grants:
            return
        self._check_failures(held, now)
        if held.is_full_for(len(token)):
            raise GrantError(f"the master holds at most {MAX_HELD} grants of one node")
        grant = self._verifier().open(token, now)
        if grant.holder != caller.thumbprint:
            raise GrantNotHeld(
                "the grant is bound to another key", f"it was issued to {grant.subject}"
            )
        check_one_domain(grant, "", caller.certified or caller.name)
        held.put(token, grant)

    def _renew(self, held: PresentedGrants, caller: Caller, token: bytes, now: int) -> bytes:
        self._check_failures(held, now)
        check = self._revocations.check
        grant, renewed = self._delegate.renew(
            token, caller.thumbprint, now, seq=self.number, check=check
        )
        if not held.is_full_for(len(renewed)):  # else the node presents it later
            held.put(renewed, grant)
        return renewed

    @staticmethod
    def _check_failures(held: PresentedGrants, now: int) -> None:
        if held.has_failed_too_often(now):
            raise GrantError(
                "too many grants of this node were refused", f"wait {FAILURE_WINDOW} s"
            )

    def _verifier(self) -> Verifier:
        anchor = self._anchor
        return Verifier(
            anchor.public_key, anchor.domain, (self._signer.public_key,), self.number,
            self._revocations.check,
        )  # fmt: skip

    def _confirm(self, now: int) -> None:
        """Confirm the list to this process, once in each second and for each list."""
        context, revocations = self._context, self._revocations
        if context.now != now or context.revocations is not revocations.data:
            if revocations.current is not None:
                revocations.confirm(self._timestamp(now), now)
            self._context = EvaluationContext(now, revocations.data, revocations.fresh_until)

    def _timestamp(self, now: int) -> Timestamp:
        return Timestamp(self.number, digest(self._revocations.data), now, MAX_AGE)


def _entries(grant: Grant) -> frozenset[bytes]:
    """The ids of a grant and of its links, and the keys they are for."""
    links = (entry for link in grant.links for entry in (link.id, link.holder))
    return frozenset((grant.holder, *links))


def _names_any(grant: Grant, names: frozenset[str]) -> Generator[None, None, bool]:
    for permission in grant.permissions:
        if any(permission.matches(name, permission.rights) for name in names):
            return True
        yield
    return False
