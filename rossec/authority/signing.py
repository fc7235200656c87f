"""The authority with its key unlocked: it signs, and records what it signs.

Everything is recorded before it is delivered. Two commands may run at the same time: decisions by
the record (a list number, the valid identities, the entries of a list) are made, signed and
recorded in one transaction, and so is a revocation with its list.
"""

import contextlib
import secrets
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from ca import errors, names, svid
from ca.authority import LIFETIME, Authority
from ca.certificates import Identity, TrustAnchor, to_pem
from ca.domains import DomainList, ForeignDomain, open_domains, sign_domains
from ca.keys.signing import PublicKey, Signer, to_coordinates
from ca.revocation.lists import MAX_ENTRIES, RevocationList, RevocationTree, TreeEntries, sign_list, sign_tree
from ca.revocation.trust_status import open_statement
from ca.store.record import GrantRow, Store
from ca.store.signed_statements import ThingRow
from ca.store.values import INTERMEDIATE, CertificateRow, RequestState, sign_head
from grants import document
from grants.model import Draft, Permission, Right
from grants.renewal import Delegation, OpenDelegation, open_delegation, sign_delegation
from rossec import files
from rossec.errors import (
    AuthorityLocked,
    ConfigurationError,
    KeyServiceFailed,
    KeyServiceRefused,
    SigningRefused,
)

SignedGrants = list[tuple[Draft, bytes]]
OF_ALL: Final = (
    AuthorityLocked,
    KeyServiceFailed,
    KeyServiceRefused,
    errors.PassphraseRefused,
    errors.RecordUnusable,
    SigningRefused,
    errors.TokenRefused,
)
"""Refusals that are about the key or the record, and so of every grant."""


def check_own_names(permissions: Iterable[Permission]) -> None:
    for permission in permissions:
        if names.is_alias(permission.pattern) and permission.rights & ~Right.GRAPH:
            raise ConfigurationError(
                f"{names.shown(permission.pattern)} is a name of another domain or site",
                "its own authority grants rights on it, by its name there; here only --graph",
            )


def check_tail(draft: Draft, valid: Iterable[CertificateRow]) -> None:
    if not draft.has_tail_patterns:
        return
    tails = [row.wildcard for row in valid if row.thumbprint == draft.holder]
    if not any(tails[-1:]):
        raise ConfigurationError(
            f"{draft.subject} is one node, and has no names of anonymous nodes",
            f"give its names as they are: {draft.subject}/..., without ~",
        )


CLOCK_SKEW: Final = 60  # seconds that another host's clock may be behind


def required_entries(store: Store, now: int) -> frozenset[bytes]:
    """The entries of a list signed at `now`."""
    # Grants that have expired and cannot be renewed are left out, and so are statements about things. A
    # node refuses a list from its future, so a node without the entry finds the grant expired (RFC 9770
    # removes entries in the same way). Keys stay: they are few, and a certificate renewed by the master may
    # be valid longer than those recorded here.
    ended = (row.id for row in store.revoked_grants() if document.peek(row.data).cap + CLOCK_SKEW < now)
    expired = (row.id for row in store.things.revoked() if row.expires + CLOCK_SKEW < now)
    return store.revoked_entries() - frozenset(ended) - frozenset(expired)


def missing_entries(store: Store, key: PublicKey, now: int) -> frozenset[bytes]:
    """The entries that the newest list, signed with `key`, lacks; all, where that is unknown."""
    with store.database.read_transaction():
        data = store.newest_list()
        listed = frozenset[bytes]()
        match None if data is None else open_statement(data, key):
            case RevocationList(entries=entries):
                listed = entries
            case RevocationTree() as tree:  # it does not contain them: they are those of the record, or not
                with contextlib.suppress(errors.RevocationRefused):
                    listed = tree_entries(store, tree).entries
            case None:
                pass
        return required_entries(store, now) - listed


def tree_entries(store: Store, tree: RevocationTree) -> TreeEntries:
    listing = TreeEntries(required_entries(store, tree.issued))
    listing.check(tree)
    return listing


DOMAIN_LIST_LIFETIME: Final = 90 * 86400
DOMAIN_LIST_REFRESH: Final = 7 * 86400


def required_domains(store: Store, now: int) -> tuple[ForeignDomain, ...]:
    found = [row.read() for row in store.domains.accepted()]
    return tuple(each for each in found if now < each.until)


def required_masters(store: Store, now: int) -> tuple[bytes, ...]:
    rows = store.identities.valid_masters(now)
    return tuple(sorted({to_coordinates(svid.key_of(svid.parse(row.der))) for row in rows}))


# An authority without foreign domains and with one master signs none; once one was signed, there always is
# one.
def is_domain_list_due(store: Store, anchor: TrustAnchor, now: int) -> bool:
    with store.database.read_transaction():
        data, domains = store.domains.newest_list(), required_domains(store, now)
        if not data:
            return bool(domains) or len({m.name for m in store.identities.valid_masters(now)}) > 1
        held = open_domains(data, anchor)
        said = held.domains, held.masters
        return now - held.issued > DOMAIN_LIST_REFRESH or said != (domains, required_masters(store, now))


def sign_domain_list(
    authority: Authority, store: Store, now: int, *, new_epoch: bool = False, above: int = 0
) -> DomainList:
    with store.transaction():
        epoch, seq = store.domains.next_number()
        if new_epoch:
            epoch, seq = max(epoch + 1, above + 1, now), 1
        said = required_domains(store, now), required_masters(store, now)
        listed = DomainList(epoch, seq, now, now + DOMAIN_LIST_LIFETIME, *said)
        data = sign_domains(authority.signer, listed, authority.anchor.domain)
        store.domains.save_list(listed.number, data, now)
    return listed


IN_FORCE: Final = "in force"
RENEWED: Final = "renewed"
EXPIRED: Final = "expired"
REVOKED: Final = "revoked"
OTHER_KEY: Final = "its border router has another key"


class ThingState(NamedTuple):
    row: ThingRow
    state: str  # one of those above


def states(store: Store, now: int) -> list[ThingState]:
    """Every statement, oldest first, with what it is at `now`."""
    with store.database.read_transaction():
        rows, revoked = store.things.all(), store.revoked_entries()
        newest = {row.name: row.id for row in store.things.in_force(now)}
        valid = {name: store.identities.valid(name, now) for name in {row.border for row in rows}}
        keys = {name: found[-1].thumbprint if found else b"" for name, found in valid.items()}

    def state(row: ThingRow) -> str:
        if row.id in revoked:
            return REVOKED
        if now >= row.expires:
            return EXPIRED
        if newest[row.name] != row.id:
            return RENEWED
        return IN_FORCE if row.read().border == keys[row.border] else OTHER_KEY

    return [ThingState(row, state(row)) for row in rows]


def ended_with(store: Store, name: str, now: int) -> frozenset[bytes]:
    """What must be revoked with the keys of `name`: statements about it, what ends with it as a router."""
    about = (row.id for row in _not_revoked(store) if row.name == name)
    return ended_with_router(store, name, now) | frozenset(about)


def ended_with_router(store: Store, border: str, now: int) -> frozenset[bytes]:
    """What must be revoked with a key of the border router `border`."""
    # The statements about its things, expired or not, and the keys of their nodes, which it has.
    # A router has the keys of the nodes that stand for its things, so they end in the same list as its own.
    alive = [row for row in _not_revoked(store) if row.border == border]
    entries = {row.id for row in alive}
    for thing in {row.name for row in alive}:
        if store.things.last(thing).border == border:
            entries |= store.unrevoked_keys(thing, now)
    return frozenset(entries)


def end_with_router(store: Store, border: str, now: int) -> None:
    for entry in sorted(ended_with_router(store, border, now)):
        store.revoke(entry, f"{border} has a new key", now)


def _not_revoked(store: Store) -> list[ThingRow]:
    revoked = store.revoked_entries()
    return [row for row in store.things.all() if row.id not in revoked]


def replaced_by(
    store: Store, name: str, border: bytes, replaced: frozenset[str], now: int
) -> frozenset[bytes]:
    """What ends where a statement about `name` at the router with the key `border` is signed."""
    # For each thing that it replaces: the statements in force, and the keys of its node where that node has
    # to be another one, under the new name or at another router.
    entries: set[bytes] = set()
    for former in sorted(replaced):
        ids = store.things.ids(former, now)
        if not ids:
            raise errors.StoreError(f"no statement about {former} is in force", "leave --replace out")
        entries |= ids
        if former != name or store.things.get(former, now).read().border != border:
            entries |= store.unrevoked_keys(former, now)
    return frozenset(entries)


SKEW: Final = CLOCK_SKEW  # backdates grants
DELEGATIONS: Final = "delegations"
OWNED: Final = (files.Owned(rf"{DELEGATIONS}/[0-9a-f]{{1,128}}\.cose"),)
OWN_NODE: Final = "/ca"  # the identity of the authority's tools
_SIZE_LIMIT: Final = 256 * 1024
_LIST_LIFETIME: Final = 90 * 86400
_LIST_REFRESH: Final = 7 * 86400  # long before it expires


@dataclass
class SigningAuthority:
    authority: Authority
    store: Store
    path: Path

    @property
    def domain(self) -> str:
        return self.authority.anchor.domain

    @property
    def signer(self) -> Signer:
        return self.authority.signer

    def issue(
        self,
        request: bytes,
        now: int,
        lifetime: int = LIFETIME,
        *,
        replace_key: str | None = None,
        wildcard: bool = False,
        source: str = "file",
    ) -> bytes:
        """Approve a request, sign and record its identity; returns the node's bundle (PEM)."""
        # With `wildcard` the identity is for anonymous nodes as well. `replace_key` is the request's name
        # again, if its key may replace another one; that key is revoked, and the list must be delivered.
        asked = svid.check_request(request, self.domain, wildcard=wildcard)
        if replace_key is not None:
            self._check_root()
        self.refresh_list(now)
        answered = self.store.identities.issued_for(asked.digest)
        if answered is not None:  # the first answer may have been lost
            self.store.identities.check_not_revoked(asked.name, asked.thumbprint)
            return self.issued_bundle(answered, now, wildcard=wildcard)
        row = self.store.requests.add(asked, request, source, now)
        if row.state is RequestState.PENDING:
            row = self.store.requests.approve(row.digest, now, replace_key=replace_key, wildcard=wildcard)
        serial = secrets.randbits(127) + 1
        der = self.authority.issue(row.der, now=now, serial=serial, lifetime=lifetime, wildcard=row.wildcard)
        identity = self.verify(der, now)
        with self.store.transaction():
            replaced = row.name if row.replaces else None
            self.store.add_certificate(
                certificate_row(identity), now, request=row.digest, replace_key=replaced
            )
            if row.replaces:
                end_with_router(self.store, row.name, now)
            self.refresh_list(now)
        return self.bundle(der)

    def verify(self, der: bytes, now: int) -> Identity:
        try:
            return self.authority.anchor.verify([der, *self.authority.chain], now)
        except errors.ForeignCertificate:
            return self.authority.anchor.verify([der], now)

    def bundle(self, der: bytes) -> bytes:
        return to_pem(der, *self.authority.chain, self.authority.anchor.certificate)

    def issued_bundle(self, row: CertificateRow, now: int, *, wildcard: bool) -> bytes:
        is_valid = row in self.store.identities.valid(row.name, now)
        if not is_valid and row.wildcard is wildcard and now > row.not_after:
            self.store.valid_certificate(row.name, now)  # says how an identity that is over comes back
        if not is_valid or row.wildcard is not wildcard:
            raise errors.StoreError(
                f"this request of {row.name} was answered, but that identity is invalid or differs",
                "make a new request on the node",
            )
        return self.bundle(row.der)

    def issue_grant(self, draft: Draft, now: int, rules: str = "") -> bytes:
        (data,) = self.issue_grants([(draft, rules)], now)
        return data

    def issue_grants(
        self, drafts: Sequence[tuple[Draft, str]], now: int, check: Callable[[], None] = lambda: None
    ) -> list[bytes]:
        """Sign grants, each with its rules, and record all of them or none."""
        # `check` raises if they must not be recorded; no other command changes the record after it.
        self._check_root("sign grants")
        for draft, _ in drafts:
            check_own_names(draft.permissions)
        signed = [document.sign(self.signer, draft) for draft, _ in drafts]  # tokens are slow
        with self.store.transaction():
            check()
            for draft, _ in drafts:
                # Again, with the record locked: the key may have been revoked since the draft was made.
                self.store.identities.check_not_revoked(draft.subject, draft.holder)
                check_tail(draft, self.store.identities.valid(draft.subject, now))
            self.refresh_list(now)
            for (draft, rules), data in zip(drafts, signed, strict=True):
                number = document.grant_id(data)
                row = GrantRow(number, draft.subject, data, draft.not_before, draft.expires)
                self.store.add_grant(row, now, rules)
        return signed

    def issue_delegation(
        self, holder: bytes, lifetime: int, max_ttl: int, now: int, *, serial: bytes = b""
    ) -> bytes:
        """Let the master with the key `holder` renew grants; recorded before it is delivered."""
        # `serial`: 16 bytes, random if not given. With the same serial and time it is the same one.
        self.refresh_list(now)
        begin = now - SKEW
        number = serial or secrets.token_bytes(16)
        draft = Delegation(self.domain, holder, begin, begin + lifetime, max_ttl, number)
        data = sign_delegation(self.signer, draft)
        files.make_private_directory(self.path / DELEGATIONS)
        name = open_delegation(data, self.signer.public_key).id.hex()
        write = files.replace if serial else files.create
        write(self.path / DELEGATIONS / f"{name}.cose", data)
        return data

    def revoke_delegations(self, reason: str, now: int) -> tuple[RevocationList, int]:
        given = delegations(self.path, self.signer.public_key)
        living = frozenset(item.id for item in given if now < item.expires)
        with self.store.transaction():
            living -= self.store.revoked_entries()
            if not living:
                raise ConfigurationError("no delegation is in force", "see: rossec master delegate")
            return self._revoke(living, reason, now), len(living)

    def revoke(self, entry: bytes, reason: str, now: int) -> RevocationList:
        return self.revoke_all(frozenset({entry}), reason, now)

    def revoke_all(self, entries: frozenset[bytes], reason: str, now: int) -> RevocationList:
        self._check_root()
        return self._revoke(entries, reason, now)

    def revoke_identity(self, name: str, reason: str, now: int) -> tuple[RevocationList, int]:
        """Revoke every key of `name`; returns the new list, and the number of keys."""
        if name == OWN_NODE:
            raise ConfigurationError(
                f"{name} is the authority's own node, which delivers lists to the master",
                "if the authority was stolen, create a new one in another ROSSEC_HOME",
            )
        sought = name if name.startswith(INTERMEDIATE) else names.check_name(name)
        with self.store.transaction():
            found = self.store.unrevoked_keys(sought, now)
            if found:
                self._check_root()
                ended = found | ended_with(self.store, sought, now)
                return self._revoke(ended, reason, now), len(found)
            self.refresh_list(now)
        certified = self.store.identities.certified_name(name, now)
        raise ConfigurationError(
            f"{name} has no valid identity to revoke",
            "see: rossec ca show; to deliver the list again: rossec ca publish"
            if certified == name
            else f"it is one of the anonymous nodes of {certified}: revoking that revokes all",
        )

    def _revoke(self, entries: frozenset[bytes], reason: str, now: int) -> RevocationList:
        with self.store.transaction():
            for entry in sorted(entries):
                self.store.revoke(entry, reason, now)
            return self.sign_list(now)

    def refresh_list(self, now: int) -> None:
        """Sign a new list if it lacks a revocation, and long before it expires; domains likewise."""
        # Every command that has the key does this, and so completes an interrupted one.
        if not self.authority.is_root:
            return
        with self.store.transaction():
            held = self.store.newest_list()
            issued = 0 if held is None else open_statement(held, self.signer.public_key).issued
            if now - issued > _LIST_REFRESH or missing_entries(self.store, self.signer.public_key, now):
                self.sign_list(now)
            if is_domain_list_due(self.store, self.authority.anchor, now):
                self.sign_domains(now)

    def sign_domains(self, now: int, *, new_epoch: bool = False, above: int = 0) -> DomainList:
        self._check_root("say which domains are trusted")
        with self.store.transaction():
            listed = sign_domain_list(self.authority, self.store, now, new_epoch=new_epoch, above=above)
            self.sign_head(now)
        return listed

    def sign_list(self, now: int, *, new_epoch: bool = False, above: int = 0) -> RevocationList:
        """Sign the list of all revocations that still matter, with the next number."""
        # With `new_epoch` it is newer than every list before, also those this record lacks. `above` is an
        # epoch that was used since, perhaps with a clock that was ahead.
        self._check_root()
        with self.store.transaction():
            epoch, seq = self.store.next_number()
            if new_epoch:  # the time, so that a backup restored twice does not use a number twice
                epoch, seq = max(epoch + 1, above + 1, now), 1
            entries = required_entries(self.store, now)
            listed = RevocationList(epoch, seq, now, now + _LIST_LIFETIME, entries)
            if len(entries) <= MAX_ENTRIES:
                data = sign_list(self.signer, listed)
            else:
                size, root = TreeEntries(entries).size_and_root
                data = sign_tree(self.signer, RevocationTree(epoch, seq, now, listed.expires, size, root))
            self.store.save_list(listed.number, data, now)
            self.sign_head(now)
        return listed

    def _check_root(self, act: str = "revoke") -> None:
        if not self.authority.is_root:
            raise ConfigurationError(f"an intermediate cannot {act}", "do it at the root")

    def sign_head(self, now: int) -> bytes:
        with self.store.transaction():
            head = sign_head(self.signer, self.store.log.head(now))
            self.store.log.add_head(head, now)
        return head


def delegations(authority: Path, key: PublicKey) -> list[OpenDelegation]:
    missing = ConfigurationError("no delegation")
    found = sorted((authority / DELEGATIONS).glob("*.cose"))
    return [open_delegation(files.read_own(path, _SIZE_LIMIT, missing), key) for path in found]


def certificate_row(identity: Identity) -> CertificateRow:
    who, key = (identity.serial, identity.name), identity.thumbprint
    return CertificateRow(*who, key, identity.certificate, identity.not_before, identity.not_after)
