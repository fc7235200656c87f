"""The authority with its key unlocked: it signs, and records what it signs.

Everything is recorded before it is delivered. Two commands may run at the same time: decisions by
the record (a list number, the valid identities, the entries of a list) are made, signed and
recorded in one transaction, and so is a revocation with its list.
"""

import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.authority import LIFETIME, Authority
from ca.certificates import Identity, check_request, to_pem
from ca.domains.lists import DomainList
from ca.errors import ForeignCertificate, RequestClosed
from ca.keys.signer import Signer
from ca.names import check_name
from ca.revocation.state import MAX_ENTRIES, RevocationList, open_statement, sign_list
from ca.revocation.tree import RevocationTree, TreeEntries, sign_tree
from ca.store.lifecycle import RequestState
from ca.store.log_entries import sign_head
from ca.store.record import CertificateRow, GrantRow, Store
from ca.store.rows import INTERMEDIATE
from grants import document
from grants.model import Draft
from grants.renewal import Delegation, OpenDelegation, open_delegation, sign_delegation
from rossec import files
from rossec.authority import domain_list, list_contents, thing_records
from rossec.authority.grantable import check_own_names, check_tail
from rossec.errors import ConfigurationError

SKEW: Final = list_contents.SKEW  # backdates grants, for hosts whose clock is behind
DELEGATIONS: Final = "delegations"
OWNED: Final = (files.Owned(rf"{DELEGATIONS}/[0-9a-f]{{1,128}}\.cose"),)
OWN_NODE: Final = "/ca"  # the identity of the authority's tools
_SIZE_LIMIT: Final = 256 * 1024
_LIST_LIFETIME: Final = 90 * 86400
_LIST_REFRESH: Final = 7 * 86400


@dataclass
class SigningAuthority:
    """The authority with its key unlocked: it can sign."""

    authority: Authority
    store: Store
    path: Path

    @property
    def domain(self) -> str:
        """Its trust domain."""
        return self.authority.anchor.domain

    @property
    def signer(self) -> Signer:
        """Its key."""
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
        """Approve a request, sign and record its identity; returns the node's bundle (PEM).

        A repeated request gets the same certificate. With `wildcard` the identity is for anonymous
        nodes as well. `replace_key` is the request's name again, if its key may replace another
        one; that key is revoked, and the list must be delivered.

        Raises:
            KeyChanged, NameContested, NameCovered: the name belongs to another key.
            RequestClosed: it was denied, or its identity is not valid any more.
        """
        asked = check_request(request, self.domain, wildcard=wildcard)
        if replace_key is not None:
            self._check_root()
        self.refresh_list(now)
        answered = self.store.identities.issued_for(asked.digest)
        if answered is not None:
            self.store.identities.check_not_revoked(asked.name, asked.thumbprint)
            return self.issued_bundle(answered, now, wildcard=wildcard)
        row = self.store.requests.add(asked, request, source, now)
        if row.state is RequestState.PENDING:
            row = self.store.requests.approve(
                row.digest, now, replace_key=replace_key, wildcard=wildcard
            )
        serial = secrets.randbits(127) + 1
        der = self.authority.issue(
            row.der, now=now, serial=serial, lifetime=lifetime, wildcard=row.wildcard
        )
        identity = self.verify(der, now)
        with self.store.transaction():
            self.store.add_certificate(
                certificate_row(identity),
                now,
                request=row.digest,
                replace_key=row.name if row.replaces else None,
            )
            if row.replaces:
                thing_records.end_with_router(self.store, row.name, now)
            self.refresh_list(now)
        return self.bundle(der)

    def verify(self, der: bytes, now: int) -> Identity:
        """The identity in a leaf signed by this authority, or by the root directly."""
        try:
            return self.authority.anchor.verify([der, *self.authority.chain], now)
        except ForeignCertificate:
            return self.authority.anchor.verify([der], now)

    def bundle(self, der: bytes) -> bytes:
        """The bundle a node installs: leaf, intermediate if there is one, root (PEM)."""
        return to_pem(der, *self.authority.chain, self.authority.anchor.certificate)

    def issued_bundle(self, row: CertificateRow, now: int, *, wildcard: bool) -> bytes:
        """The bundle issued for a request before, as the first answer may be lost."""
        is_valid = row in self.store.identities.valid(row.name, now)
        if not is_valid and row.wildcard is wildcard and now > row.not_after:
            self.store.valid_certificate(
                row.name, now
            )  # says how an identity that is over comes back
        if not is_valid or row.wildcard is not wildcard:
            raise RequestClosed(
                f"this request of {row.name} was answered, but that identity is invalid or differs",
                "make a new request on the node",
            )
        return self.bundle(row.der)

    def issue_grant(self, draft: Draft, now: int, rules: str = "") -> bytes:
        """Sign and record a grant; `rules`: those of the policy it came from, if it did.

        Raises:
            ConfigurationError: this is an intermediate, whose grants no node accepts.
            StoreError: its key was revoked since the draft was made.
        """
        (data,) = self.issue_grants([(draft, rules)], now)
        return data

    def issue_grants(
        self,
        drafts: Sequence[tuple[Draft, str]],
        now: int,
        check: Callable[[], None] = lambda: None,
    ) -> list[bytes]:
        """Sign grants, each with its rules, and record all of them or none.

        `check` raises if they must not be recorded; no other command changes the record after it.

        Raises:
            ConfigurationError, StoreError: as `issue_grant`.
        """
        self._check_root("sign grants")
        for draft, _ in drafts:
            check_own_names(draft.permissions)
        signed = [document.sign(self.signer, draft) for draft, _ in drafts]  # tokens are slow
        with self.store.transaction():
            check()
            for draft, _ in drafts:
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
        """Let the master with the key `holder` renew grants; recorded before it is delivered.

        `serial`: 16 bytes, random if not given. With the same serial and time it is the same one.

        Raises:
            RenewalMalformed: the lifetime is too long.
        """
        self.refresh_list(now)
        begin = now - SKEW
        draft = Delegation(
            self.domain, holder, begin, begin + lifetime, max_ttl,
            serial or secrets.token_bytes(16),
        )  # fmt: skip
        data = sign_delegation(self.signer, draft)
        files.make_private_directory(self.path / DELEGATIONS)
        name = open_delegation(data, self.signer.public_key).id.hex()
        write = files.replace if serial else files.create
        write(self.path / DELEGATIONS / f"{name}.cose", data)
        return data

    def revoke_delegations(self, reason: str, now: int) -> tuple[RevocationList, int]:
        """Revoke every delegation that has not expired; returns the list, and their number.

        Raises:
            ConfigurationError: there is none.
        """
        given = delegations(self.path, self.signer.public_key)
        living = frozenset(item.id for item in given if now < item.expires)
        with self.store.transaction():
            living -= self.store.revoked_entries()
            if not living:
                raise ConfigurationError("no delegation is in force", "see: rossec master delegate")
            return self._revoke(living, reason, now), len(living)

    def revoke(self, entry: bytes, reason: str, now: int) -> RevocationList:
        """Revoke a grant id or key thumbprint, and sign a new list."""
        return self.revoke_all(frozenset({entry}), reason, now)

    def revoke_all(self, entries: frozenset[bytes], reason: str, now: int) -> RevocationList:
        """As `revoke`, all of `entries` with one list."""
        self._check_root()
        return self._revoke(entries, reason, now)

    def revoke_identity(self, name: str, reason: str, now: int) -> tuple[RevocationList, int]:
        """Revoke every key of `name`; returns the new list, and the number of keys.

        Raises:
            ConfigurationError: there is none, or it is the authority's own.
        """
        if name == OWN_NODE:
            raise ConfigurationError(
                f"{name} is the authority's own node, which delivers lists to the master",
                "if the authority was stolen, create a new one in another ROSSEC_HOME",
            )
        sought = name if name.startswith(INTERMEDIATE) else check_name(name)
        with self.store.transaction():
            found = self.store.unrevoked_keys(sought, now)
            if found:
                self._check_root()
                ended = found | thing_records.ended_with(self.store, sought, now)
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
        """Record revocations and sign the new list, in one transaction."""
        with self.store.transaction():
            for entry in sorted(entries):
                self.store.revoke(entry, reason, now)
            return self.sign_list(now)

    def _sign_list_or_tree(self, listed: RevocationList) -> bytes:
        """Sign the list, or a tree if it has too many entries."""
        if len(listed.entries) <= MAX_ENTRIES:
            return sign_list(self.signer, listed)
        size, root = TreeEntries(listed.entries).size_and_root
        tree = RevocationTree(listed.epoch, listed.seq, listed.issued, listed.expires, size, root)
        return sign_tree(self.signer, tree)

    def refresh_list(self, now: int) -> None:
        """Sign a new list if it lacks a revocation, and long before it expires; domains likewise.

        Every command that has the key does this, and so completes an interrupted one.
        """
        if not self.authority.is_root:
            return
        with self.store.transaction():
            held = self.store.newest_list()
            issued = 0 if held is None else open_statement(held, self.signer.public_key).issued
            late = now - issued > _LIST_REFRESH
            if late or list_contents.missing_entries(self.store, self.signer.public_key, now):
                self.sign_list(now)
            if domain_list.is_due(self.store, self.authority.anchor, now):
                self.sign_domains(now)

    def sign_domains(self, now: int, *, new_epoch: bool = False, above: int = 0) -> DomainList:
        """Sign the list of domains with the next number; see `domain_list` and `sign_list`.

        Raises:
            ConfigurationError: this is an intermediate.
            DomainsRefused: there are too many.
        """
        self._check_root("say which domains are trusted")
        with self.store.transaction():
            listed = domain_list.sign(
                self.authority, self.store, now, new_epoch=new_epoch, above=above
            )
            self.sign_head(now)
        return listed

    def sign_list(self, now: int, *, new_epoch: bool = False, above: int = 0) -> RevocationList:
        """Sign the list of all revocations that still matter, with the next number.

        With `new_epoch` it is newer than every list before, also those this record lacks: the epoch
        is the time, so that a backup restored twice does not use the same number twice. `above` is
        an epoch that was used since, perhaps with a clock that was ahead.

        Raises:
            ConfigurationError: this is an intermediate.
        """
        self._check_root()
        with self.store.transaction():
            epoch, seq = self.store.next_number()
            if new_epoch:
                epoch, seq = max(epoch + 1, above + 1, now), 1
            entries = list_contents.required_entries(self.store, now)
            listed = RevocationList(epoch, seq, now, now + _LIST_LIFETIME, entries)
            self.store.save_list(listed.number, self._sign_list_or_tree(listed), now)
            self.sign_head(now)
        return listed

    def _check_root(self, act: str = "revoke") -> None:
        if not self.authority.is_root:
            raise ConfigurationError(f"an intermediate cannot {act}", "do it at the root")

    def sign_head(self, now: int) -> bytes:
        """Sign the head of the log, which shows whether the log was rewritten since."""
        with self.store.transaction():
            head = sign_head(self.signer, self.store.log.head(now))
            self.store.log.add_head(head, now)
        return head


def delegations(authority: Path, key: ec.EllipticCurvePublicKey) -> list[OpenDelegation]:
    """Every delegation signed by the authority with this directory and key."""
    missing = ConfigurationError("no delegation")
    found = sorted((authority / DELEGATIONS).glob("*.cose"))
    return [open_delegation(files.read_own(path, _SIZE_LIMIT, missing), key) for path in found]


def certificate_row(identity: Identity) -> CertificateRow:
    """The row that records an identity."""
    return CertificateRow(
        identity.serial, identity.name, identity.thumbprint, identity.certificate,
        identity.not_before, identity.not_after,
    )  # fmt: skip
