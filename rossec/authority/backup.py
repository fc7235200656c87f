"""Back up an authority into one file, and restore it without losing data by accident.

A restore verifies the backup first, next to its target: the key opens and matches its certificate,
the log verifies. An existing authority is replaced only if the operator names its trust domain, and
newer log entries are lost only if the operator gives their number. The backup lacks what was signed
after it, so a new epoch of lists begins, and signed lists from the master or a node restore the
missing revocations, and the domains that are trusted; without one no foreign domain is.
"""

import contextlib
import secrets
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Final

from ca.certificates import TrustAnchor
from ca.domains.lists import ForeignDomain, open_domains
from ca.errors import BackupRefused, DomainsRefused, HintedError, LogDamaged, PassphraseRefused
from ca.revocation.state import open_list
from ca.revocation.tree import TreeEntries, is_tree, open_tree
from ca.store import backup
from ca.store.approval_replay import RESTORED
from ca.store.log_entries import LogEntry
from rossec import files
from rossec.authority.home import AUDIT_FILE, AuthorityHome
from rossec.authority.keyservice.lock import LOCK, service_lock
from rossec.authority.signing import SigningAuthority

# The record goes in as a snapshot; the audit is of one host, and may be larger than a backup.
_SKIPPED: Final = ("ca.db", "ca.db-wal", "ca.db-shm", LOCK)
_HINT: Final = "take another backup, and find out who made this one"
_PUBLIC: Final = ".pem"
_REASON: Final = "restored from a backup"


@dataclass(frozen=True)
class Restored:
    """The result of a restore: the directory, and the number of log entries."""

    home: AuthorityHome
    entries: int
    restored_revocations: int  # revocations added from a newer list
    ended_phones: int = 0  # passkeys that could approve
    ended_domains: int = 0  # foreign domains that were trusted


def back_up(home: AuthorityHome, passphrase: str) -> bytes:
    """Return a backup of the authority, encrypted with `passphrase`."""
    content = {
        str(path): (home.path / path).read_bytes()
        for path in sorted(each.relative_to(home.path) for each in home.path.rglob("*"))
        if (home.path / path).is_file() and path.name not in _SKIPPED
        and not path.name.startswith((".", AUDIT_FILE)) and "grants" not in path.parts
    }  # fmt: skip
    with contextlib.closing(home.store()) as store:
        content["ca.db"] = store.database.snapshot()
    salt, nonce = secrets.token_bytes(backup.SALT_SIZE), secrets.token_bytes(backup.NONCE_SIZE)
    return backup.seal(content, passphrase, salt=salt, nonce=nonce)


def restore(
    home: Path,
    data: bytes,
    passphrase: str,
    now: int,
    *,
    secret: str | None = None,
    over: str | None = None,
    forget: int = 0,
    newest_list: bytes | None = None,
    entries: bytes | None = None,
    newest_domains: bytes | None = None,
) -> Restored:
    """Restore an authority into ROSSEC_HOME `home`.

    Args:
        home: ROSSEC_HOME.
        data: the backup.
        passphrase: of the backup.
        now: the time.
        secret: the passphrase or PIN of the key, if it is another one.
        over: the trust domain of the authority that may be replaced.
        forget: the number of its log entries that the backup lacks, and that may be lost.
        newest_list: a signed revocation list, or tree, that may be newer than the backup.
        entries: those of the tree, which does not contain them.
        newest_domains: a signed list of domains that may be newer than the backup.

    Raises:
        ConfigurationError: the authority's service runs.
        BackupRefused: not a backup, incomplete, or `over` or `forget` do not match.
        RevocationRefused: the list, tree or entries are not the authority's.
        DomainsRefused: the list of domains is not, or is older than the backup.
        PassphraseRefused: the passphrase is wrong.
        LogDamaged: the backup's own log does not verify.
    """
    target = home / "ca"
    staging = target.with_name(f".ca.{secrets.token_hex(8)}")
    try:
        _write(staging, backup.unseal(data, passphrase))
        authority = _open_verified(AuthorityHome(staging), secret or passphrase)
        size = authority.store.log.head(now).size
        newest = _revoked_by(newest_list, entries, authority)
        domains = _listed_by(newest_domains, authority)
        with _locked(target):
            if target.exists():
                _check_replacement(AuthorityHome(target), authority, over, forget)
            phones = _end_what_was_open(authority, size, now)
            with authority.store.transaction():
                ended = _end_domains(authority, domains, now)
                revived = _start_new_epoch(authority, newest, now)
            authority.store.close()
            if target.exists():
                aside = (target.with_name(f"ca.replaced.{number}") for number in count(now))
                target.rename(next(path for path in aside if not path.exists()))
            files.commit_directory(staging, target)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        raise
    return Restored(AuthorityHome(target), size, revived, phones, ended)


def _open_verified(staging: AuthorityHome, secret: str) -> SigningAuthority:
    """The authority in a backup, if key, certificate and record are valid and match.

    Raises:
        BackupRefused: a part is missing or invalid.
        PassphraseRefused, LogDamaged: as `restore`.
    """
    try:
        authority = staging.unlock(secret)
        authority.store.log.audit(authority.signer.public_key)
        authority.store.database.check()
        newest = authority.store.newest_list()
        if newest is not None and authority.authority.is_root:
            key = authority.authority.anchor.public_key
            open_tree(newest, key) if is_tree(newest) else open_list(newest, key)
    except (PassphraseRefused, LogDamaged):
        raise
    except (HintedError, ValueError) as error:
        reason = error if isinstance(error, HintedError) else "not exactly one certificate"
        raise BackupRefused(
            f"the backup does not contain a valid authority: {reason}", _HINT
        ) from error
    return authority


@contextlib.contextmanager
def _locked(target: Path) -> Iterator[None]:
    """Lock the service and the record at `target` from the comparison until it is moved."""
    with contextlib.ExitStack() as stack:
        if target.is_dir() and not target.is_symlink():  # nothing is written behind a link
            stack.enter_context(service_lock(target))
        with contextlib.suppress(HintedError):  # an incomplete authority: `_read` reports it
            store = stack.enter_context(contextlib.closing(AuthorityHome(target).store()))
            stack.enter_context(store.transaction())
        yield


def _write(directory: Path, content: dict[str, bytes]) -> None:
    for name, data in content.items():
        path = directory / name
        files.make_private_directory(path.parent)
        files.create(path, data, 0o644 if name.endswith(_PUBLIC) else 0o600)


def _check_replacement(
    there: AuthorityHome, found: SigningAuthority, over: str | None, forget: int
) -> None:
    """Refuse to replace an existing authority unless `over` and `forget` match."""
    anchor, held = _read(there)
    if over != anchor.domain:
        raise BackupRefused(
            f"there is an authority in {there.path}",
            f"to replace it with the backup: --over {there.domain}",
        )
    if anchor.thumbprint != found.authority.anchor.thumbprint:
        raise BackupRefused(
            f"the authority in {there.path} is not the one in the backup",
            "restore it into another ROSSEC_HOME",
        )
    backed = found.store.log.entries()
    shared = sum(1 for ours, theirs in zip(held, backed, strict=False) if ours == theirs)
    lost = len(held) - shared
    if lost != forget:
        raise BackupRefused(
            f"the backup lacks {lost} entries of the log in {there.path}",
            f"it is older; to lose them permanently: --forget {lost}",
        )


def _read(there: AuthorityHome) -> tuple[TrustAnchor, list[LogEntry]]:
    """The trust anchor and the log of an existing authority."""
    try:
        with contextlib.closing(there.store()) as store:
            return there.anchor(), store.log.entries()
    except HintedError as error:
        raise BackupRefused(
            f"the authority in {there.path} is incomplete: {error}",
            "move that directory away and restore again: its log cannot be compared",
        ) from error


def _revoked_by(
    data: bytes | None, entries: bytes | None, authority: SigningAuthority
) -> frozenset[bytes]:
    """The entries that a signed statement revokes, if there is one."""
    key = authority.authority.anchor.public_key
    if data is None:
        return frozenset()
    if not is_tree(data):
        return open_list(data, key).entries
    if entries is None:
        raise BackupRefused(
            "the newest revocations are a tree, which does not contain its entries",
            "give its entries with --entries: the master has them in revocations.entries",
        )
    listing = TreeEntries.read(entries)
    listing.check(open_tree(data, key))
    return listing.entries


def _listed_by(data: bytes | None, authority: SigningAuthority) -> tuple[ForeignDomain, ...]:
    """The domains that a signed list names, if there is one."""
    if data is None:
        return ()
    anchor = authority.authority.anchor
    found, held = open_domains(data, anchor), authority.store.domains.newest_list()
    if held and found.number < open_domains(held, anchor).number:
        raise DomainsRefused("the list of domains is older than the backup", "give a newer one")
    return found.domains


def _end_domains(authority: SigningAuthority, newest: tuple[ForeignDomain, ...], now: int) -> int:
    """Trust the domains of the newest list, with its terms; returns how many are trusted no more.

    One may have been removed since the backup: without a list, none is trusted.
    """
    domains, wanted = authority.store.domains, {each.terms: each for each in newest}
    ended = [row for row in domains.accepted() if row.terms not in wanted]
    for row in ended:
        domains.end(row.label, _REASON, now)
    held = {row.terms for row in domains.accepted()}
    for terms, each in wanted.items():
        if terms not in held:
            domains.accept(each, now)
    named = {each.domain for each in newest}
    return sum(row.domain not in named for row in ended)


def _end_what_was_open(authority: SigningAuthority, entries: int, now: int) -> int:
    """Note the restore, and end what the backup does not know enough of; returns how many passkeys.

    Of an invitation's uses some may have been taken since, a passkey may have been removed, and an
    approval been carried out.
    """
    authority.store.log_event(RESTORED, "record", f"from {entries} entries", now)
    authority.store.invitations.end_all(_REASON, now)
    authority.store.approvals.end_waiting(_REASON, now)
    return authority.store.passkeys.end_all(_REASON, now)


def _start_new_epoch(authority: SigningAuthority, newest: frozenset[bytes], now: int) -> int:
    """Start a new epoch and add missing revocations; an intermediate has neither."""
    if not authority.authority.is_root:
        return 0
    missing = newest - authority.store.revoked_entries()
    with authority.store.transaction():
        for entry in sorted(missing):
            authority.store.revoke(entry, "from a list newer than the backup", now)
        authority.sign_list(now, new_epoch=True)
        if authority.store.domains.newest_list() or authority.store.domains.accepted():
            authority.sign_domains(now, new_epoch=True)
    return len(missing)
