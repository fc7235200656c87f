"""What the authority has said and what the nodes have shown: revocations and grants. Pure.

The master is its own source of freshness: it holds the list, so it confirms it to itself and signs
the timestamps by which nodes know that nothing newer is being held back. Without a list, or with
an expired one, identities may still connect (somebody must be able to bring a list), but no grant
holds. Grants are kept per key, verified once, bounded in number and size.
"""

import hashlib
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from typing import Final

from ca.certificates import TrustAnchor
from ca.errors import HintedError, RenewalRefused, RevocationRefused, Revoked
from ca.keys.signer import Signer
from ca.revocation.state import MAX_AGE, Revocations, Timestamp, digest, sign_timestamp
from ca.revocation.tree import TreeEntries, is_tree, open_tree
from grants.decision import RevocationCheck
from grants.errors import GrantError, GrantNotHeld
from grants.model import Grant
from grants.token import Verifier
from rossec.master.rights.access_rules import Caller, Certified, Peer
from rossec.master.rights.delegation import Delegate, forget
from rossec.master.rights.interfaces import Presented, Renewed
from rossec.master.rights.presented_grants import (
    FAILURES_WITHIN,
    MAX_HELD,
    NEVER,
    NOTHING,
    GrantAccess,
    Moment,
    PresentedGrants,
)

_PUBLISH: Final = "deliver it with: rossec ca publish"
MAX_NAMES: Final = 16 * 1024  # nodes of which is known which list they hold


Renewer = Callable[[bytes, int, RevocationCheck], bytes]
"""Answers a renewal request (`ca.renewal`) with the node's new bundle."""


class TrustState:
    """The master's `TrustView`.

    Args:
        anchor: the authority, and the domain that grants must be for.
        signer: the master's own identity key; signs timestamps.
        revocations: loaded with what was persisted, if anything.
        persist: makes a list durable; called before the list takes effect.
        delegate: renews grants; by default the authority has not delegated that.
        renewer: answers a request to renew an identity, `check` says what is revoked; None: nobody.
        persist_entries: makes the entries of a tree durable, before the tree itself.
    """

    def __init__(
        self,
        anchor: TrustAnchor,
        signer: Signer,
        revocations: Revocations,
        persist: Callable[[bytes], None],
        delegate: Delegate | None = None,
        persist_entries: Callable[[bytes], None] = forget,
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
        self._ended: dict[bytes, Grant] = {}
        self._lists: dict[tuple[str, bytes], bytes] = {}
        self._chains: dict[bytes, tuple[bytes, ...]] = {}  # by the first key: all of an identity
        self._stamp: tuple[int, bytes] = (-1, b"")
        self._moment = NEVER

    def caller(self, peer: Certified, now: int) -> Caller:
        """Who calls and what it may do now.

        Raises:
            Revoked: the key is revoked, or that of the intermediate it hangs on.
        """
        keys = self._chains[peer.thumbprint] = peer.keys
        if self._is_revoked(keys):
            raise Revoked(f"the key of {peer.name} is revoked", "enroll the node with a new key")
        return self._caller(peer, now, wildcard=peer.wildcard)

    def caller_of(self, peer: Peer, now: int) -> Caller | None:
        """What a name and key seen before may do now; None: the key is revoked."""
        if self._is_revoked(self._chains.get(peer.thumbprint, (peer.thumbprint,))):
            return None
        return self._caller(peer, now)

    def present(self, caller: Caller, tokens: Sequence[bytes], now: int) -> Presented:
        """Verify and keep grants; one that is refused does not spoil the others.

        Nothing is kept for a key that the tokens are not bound to.
        """
        self._confirm(now)
        held = self._held.setdefault(caller.thumbprint, PresentedGrants())
        held.drop_expired(now)
        refused: list[str] = []
        for token in tokens:
            try:
                self._keep(held, caller, token, now)
            except HintedError as error:
                held.count_failure(now)
                refused.append(str(error))
        return Presented(len(held.grants), tuple(refused))

    def revoked(self) -> frozenset[bytes]:
        """The whole list."""
        return self._revocations.entries

    def pertaining(
        self, caller: Caller, names: Iterable[str]
    ) -> Generator[None, None, frozenset[bytes]]:
        """What of the list concerns a caller that is registered for `names`.

        Its own grants; grants for these names, whoever holds them, and their holders' keys; what
        renews grants. The master knows of grants that were presented to it: of others nobody here
        could say whom they concern. Yields wherever others may have their turn.
        """
        keys, entries = frozenset(names), self._revocations.entries
        concerned = {caller.thumbprint, self._delegate.id}
        revoked = [item for item in self._known() if not entries.isdisjoint((item.id, item.holder))]
        for grant in revoked:
            if grant.holder == caller.thumbprint or (yield from _reaches(grant, keys)):
                concerned |= {grant.id, grant.holder}
        return entries & concerned

    def renew(self, caller: Caller, tokens: Sequence[bytes], now: int) -> Renewed:
        """Tokens that hold longer, in the same order, empty where one is not renewed."""
        self._confirm(now)
        held = self._held.setdefault(caller.thumbprint, PresentedGrants())
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
        """The bundle that succeeds an identity, by the intermediate of this host.

        Raises:
            CAError: not in order, or there is no intermediate here.
        """
        if self._renewer is None:
            raise RenewalRefused("this master renews no identities", "ask the authority's operator")
        self._confirm(now)
        held = self._held.setdefault(caller.thumbprint, PresentedGrants())
        self._check_failures(held, now)
        try:
            return self._renewer(request, now, self._revocations.check)
        except HintedError:
            held.count_failure(now)
            raise

    def check(self, entry: bytes, now: int) -> None:
        """As `Revocations.check`, by what the master holds now."""
        self._confirm(now)
        self._revocations.check(entry, now)

    def delegated(self, data: bytes) -> bool:
        """Take leave of the authority to renew grants; returns whether it is newer.

        Raises:
            GrantError: not the authority's, or not for this master.
        """
        return self._delegate.take(data)

    def current(self, now: int) -> tuple[bytes, bytes]:
        """The list and a timestamp of this second; empty while there is no list."""
        revocations = self._revocations.current
        if revocations is None:
            return b"", b""
        if self._stamp[0] != now:
            self._stamp = now, sign_timestamp(self._signer, self._timestamp(now))
        return self._revocations.data, self._stamp[1]

    def held_by(self, peer: Peer, held: bytes) -> None:
        """A node says which list it holds, by its digest; believed only to spare it the list."""
        if len(self._lists) >= MAX_NAMES:  # a wildcard identity goes by as many as it likes
            self._lists.clear()
        self._lists[peer.name, peer.thumbprint] = held

    def news_for(self, peer: Peer, now: int) -> tuple[bytes, bytes]:
        """As `current`, but without the list for a node that has said that it holds it."""
        data, stamp = self.current(now)
        return (
            b"" if self._lists.get((peer.name, peer.thumbprint)) == digest(data) else data
        ), stamp

    @property
    def number(self) -> int:
        """Sequence number of the list in force; 0: none."""
        return 0 if self._revocations.current is None else self._revocations.current.seq

    def update(self, data: bytes, now: int) -> bool:
        """Take a list signed by the authority; returns whether it differs from the one held.

        Raises:
            RevocationRefused: forged, malformed, or older than one seen.
        """
        if is_tree(data):
            raise RevocationRefused("a tree of revocations comes with its entries", _PUBLISH)
        before = self._revocations.data
        self._revocations.update(data, now, self._persist)
        self._listing = None
        return self._updated(before)

    def update_tree(self, data: bytes, entries: bytes, now: int) -> bool:
        """Take a tree signed by the authority, and all it was made of; as `update`."""
        signed = open_tree(data, self._anchor.public_key)  # before anything is done for a stranger
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
        return self._updated(before)

    def proofs(self, entries: Sequence[bytes]) -> list[bytes]:
        """What the tree shows of each entry; nothing while the whole list is at hand."""
        return [] if self._listing is None else [self._listing.prove(item) for item in entries]

    def _updated(self, before: bytes) -> bool:
        """Forget what followed from the statement `before`; returns whether it is another now."""
        self._ended = {
            grant.id: grant
            for grant in self._known()
            if not self._revocations.entries.isdisjoint((grant.id, grant.holder))
        }
        self._stamp, self._moment = (-1, b""), NEVER
        return self._revocations.data != before

    def keep_only(self, thumbprints: frozenset[bytes], now: int) -> None:
        """Forget the grants of all other keys, and what has expired of these."""
        self._held = {key: held for key, held in self._held.items() if key in thumbprints}
        self._lists = {key: held for key, held in self._lists.items() if key[1] in thumbprints}
        self._chains = {key: keys for key, keys in self._chains.items() if key in thumbprints}
        for held in self._held.values():
            held.drop_expired(now)

    def _is_revoked(self, keys: tuple[bytes, ...]) -> bool:
        return not self._revocations.entries.isdisjoint(keys)

    def _caller(self, peer: Peer, now: int, *, wildcard: bool = False) -> Caller:
        self._confirm(now)
        held = self._held.get(peer.thumbprint)
        if held is not None:
            return held.caller(peer, self._moment, self._revocations, wildcard=wildcard)
        access = GrantAccess((), NOTHING, peer.thumbprint, now, self._revocations.check)
        return Caller(peer.name, peer.thumbprint, access, wildcard)

    def _known(self) -> Iterator[Grant]:
        """Grants presented by those who are here, and those remembered because of the list."""
        yield from self._ended.values()
        for held in self._held.values():
            yield from held.grants.values()

    def _keep(self, held: PresentedGrants, caller: Caller, token: bytes, now: int) -> None:
        key = hashlib.sha256(token).digest()
        if key in held.grants:
            return
        self._check_failures(held, now)
        if held.is_full_for(len(token)):
            raise GrantError(f"the master holds at most {MAX_HELD} grants of one node")
        grant = self._verifier().open(token, now)
        if grant.holder != caller.thumbprint:
            raise GrantNotHeld("a grant bound to another key", f"it was issued to {grant.subject}")
        held.put(token, grant)

    def _renew(self, held: PresentedGrants, caller: Caller, token: bytes, now: int) -> bytes:
        self._check_failures(held, now)
        check = self._revocations.check
        grant, renewed = self._delegate.renew(
            token, caller.thumbprint, now, seq=self.number, check=check
        )
        if not held.is_full_for(len(renewed)):  # else its holder presents it when it has room
            held.put(renewed, grant)
        return renewed

    @staticmethod
    def _check_failures(held: PresentedGrants, now: int) -> None:
        if held.has_failed_too_often(now):
            raise GrantError(
                "too many grants of this node were refused", f"wait {FAILURES_WITHIN} s"
            )

    def _verifier(self) -> Verifier:
        anchor = self._anchor
        return Verifier(
            anchor.public_key, anchor.domain, self._signer.public_key, self.number,
            self._revocations.check,
        )  # fmt: skip

    def _confirm(self, now: int) -> None:
        """Confirm the list to ourselves, once in each second and for each list."""
        moment, revocations = self._moment, self._revocations
        if moment.now != now or moment.revocations is not revocations.data:
            if revocations.current is not None:
                revocations.confirm(self._timestamp(now), now)
            self._moment = Moment(now, revocations.data, revocations.fresh_until)

    def _timestamp(self, now: int) -> Timestamp:
        return Timestamp(self.number, digest(self._revocations.data), now, MAX_AGE)


def _reaches(grant: Grant, names: frozenset[str]) -> Generator[None, None, bool]:
    for permission in grant.permissions:
        if any(permission.matches(name, permission.rights) for name in names):
            return True
        yield
    return False
