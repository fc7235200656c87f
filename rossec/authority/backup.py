"""Back an authority up into one file, and restore it where that loses nothing by accident.

A shell. Restoring proves the backup first, beside its target: the key opens and fits its
certificate, the log verifies. An authority that is there already is replaced only if the operator
names its trust domain, and newer entries are given up only if the operator says how many. What was
signed after the backup is unknown to it, so a new epoch of revocation lists begins, and a signed
list kept by the master or a node brings back the revocations that are missing.
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
from ca.errors import BackupRefused, HintedError, LogDamaged, PassphraseRefused
from ca.revocation.state import open_list
from ca.revocation.tree import TreeEntries, is_tree, open_tree
from ca.store import backup
from ca.store.log_entries import LogEntry
from rossec import files
from rossec.authority.home import AuthorityHome
from rossec.authority.signing import SigningAuthority

_SKIPPED: Final = ("ca.db", "ca.db-wal", "ca.db-shm")  # the record goes in as a snapshot
_HINT: Final = "take another backup, and find out who made this one"
_PUBLIC: Final = ".pem"


@dataclass(frozen=True)
class Restored:
    """What was restored: how many log entries, of which state of the authority."""

    home: AuthorityHome
    entries: int
    restored_revocations: int  # revocations brought back from a list


def back_up(home: AuthorityHome, passphrase: str) -> bytes:
    """The backup of an authority, of this moment, under `passphrase`."""
    content = {
        str(path): (home.path / path).read_bytes()
        for path in sorted(each.relative_to(home.path) for each in home.path.rglob("*"))
        if (home.path / path).is_file() and path.name not in _SKIPPED
        and not path.name.startswith(".") and "grants" not in path.parts
    }  # fmt: skip
    with contextlib.closing(home.store()) as store:
        content["ca.db"] = store.snapshot()
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
) -> Restored:
    """Put an authority back into ROSSEC_HOME `home`.

    Args:
        home: ROSSEC_HOME.
        data: the backup.
        passphrase: of the backup.
        now: the time.
        secret: what opens the key, if that is not the same passphrase (a token's PIN).
        over: the trust domain of the authority that may be replaced.
        forget: how many log entries of it the backup lacks, and may be lost.
        newest_list: a signed revocation list, or tree, that may be newer than the backup.
        entries: of the tree, which does not name them itself.

    Raises:
        BackupRefused: no backup, not whole, or not in these words.
        RevocationRefused: the list, tree or entries are not the authority's.
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
        with _locked(target):
            if target.exists():
                _check_replacement(AuthorityHome(target), authority, over, forget)
            revived = _start_new_epoch(authority, newest, size, now)
            authority.store.close()
            if target.exists():
                aside = (target.with_name(f"ca.replaced.{number}") for number in count(now))
                target.rename(next(path for path in aside if not path.exists()))
            files.commit_directory(staging, target)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        raise
    return Restored(AuthorityHome(target), size, revived)


def _open_verified(staging: AuthorityHome, secret: str) -> SigningAuthority:
    """The authority in a backup, if key, certificate and record are whole and of one another.

    Raises:
        BackupRefused: a part is missing, or is not what it must be.
        PassphraseRefused, LogDamaged: as `restore`.
    """
    try:
        authority = staging.unlock(secret)
        authority.store.log.audit(authority.signer.public_key)
        authority.store.check()
        newest = authority.store.newest_list()
        if newest is not None and authority.authority.is_root:
            key = authority.authority.anchor.public_key
            open_tree(newest, key) if is_tree(newest) else open_list(newest, key)
    except (PassphraseRefused, LogDamaged):
        raise
    except (HintedError, ValueError) as error:  # also: not one certificate where one belongs
        raise BackupRefused(f"what is in the backup is no authority: {error}", _HINT) from error
    return authority


@contextlib.contextmanager
def _locked(target: Path) -> Iterator[None]:
    """Lock the record at `target` from its comparison with the backup until it is moved away."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(HintedError):  # no whole authority: `_read` says so
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
    """The one that is there gives way to the backup only knowingly."""
    anchor, held = _read(there)
    if over != anchor.domain:
        raise BackupRefused(
            f"there is an authority in {there.path}",
            f"to replace it with the backup say --over {there.domain}",
        )
    if anchor.thumbprint != found.authority.anchor.thumbprint:
        raise BackupRefused(
            f"the authority in {there.path} is another one than that of the backup",
            "restore it into another ROSSEC_HOME",
        )
    backed = found.store.log.entries()
    shared = sum(1 for ours, theirs in zip(held, backed, strict=False) if ours == theirs)
    lost = len(held) - shared
    if lost != forget:
        raise BackupRefused(
            f"the backup lacks {lost} entries of the log in {there.path}",
            f"it is older; to lose them for good say --forget {lost}",
        )


def _read(there: AuthorityHome) -> tuple[TrustAnchor, list[LogEntry]]:
    """Who is there, and what it did."""
    try:
        with contextlib.closing(there.store()) as store:
            return there.anchor(), store.log.entries()
    except HintedError as error:
        raise BackupRefused(
            f"what is in {there.path} is no whole authority: {error}",
            "move that directory away and restore again: its newest entries cannot be compared",
        ) from error


def _revoked_by(
    data: bytes | None, entries: bytes | None, authority: SigningAuthority
) -> frozenset[bytes]:
    """What a signed statement revokes; none: nothing."""
    key = authority.authority.anchor.public_key
    if data is None:
        return frozenset()
    if not is_tree(data):
        return open_list(data, key).entries
    if entries is None:
        raise BackupRefused(
            "the newest revocations are a tree, which does not say what is in it",
            "name its entries too, with --entries: the master keeps them as revocations.entries",
        )
    listing = TreeEntries.read(entries)
    listing.check(open_tree(data, key))
    return listing.entries


def _start_new_epoch(
    authority: SigningAuthority, newest: frozenset[bytes], entries: int, now: int
) -> int:
    """A new epoch, and what was revoked since; an intermediate has neither."""
    authority.store.log_event("restored", "record", f"from {entries} entries", now)
    if not authority.authority.is_root:
        return 0
    missing = newest - authority.store.revoked_entries()
    with authority.store.transaction():
        for entry in sorted(missing):
            authority.store.revoke(entry, "from a list newer than the backup", now)
        authority.sign_list(now, new_epoch=True)
    return len(missing)
