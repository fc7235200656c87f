"""Back up an authority into one file, and restore it without losing data by accident.

What is in a backup, each part says that owns files (`contents`). A restore verifies the backup
first, next to its target: the key opens and matches its certificate, the log verifies; code that it
names is not run (`token_modules`). An existing authority is replaced only if the operator names its
trust domain, and in one step; newer log entries are lost only if the operator gives their number,
and what it has revoked stays revoked. The backup lacks what was signed after it, so a new epoch of
lists begins, and signed lists from the master or a node restore the missing revocations, and the
domains that are trusted (`restored_lists`); without one no foreign domain is.
"""

import contextlib
import secrets
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Final

from ca.certificates import TrustAnchor
from ca.errors import BackupRefused, HintedError, LogDamaged, PassphraseRefused
from ca.keys.hsm import KeyUri
from ca.revocation.state import open_list
from ca.revocation.tree import is_tree, open_tree
from ca.store import backup
from ca.store.approval_replay import RESTORED
from ca.store.lifecycle import RequestState
from ca.store.log_entries import LogEntry
from rossec import files
from rossec.authority import contents, policyfile, restored_lists, token_modules
from rossec.authority.home import KEY_URI, RECORD, AuthorityHome
from rossec.authority.keyservice.lock import service_lock
from rossec.authority.restored_lists import NewerLists
from rossec.authority.signing import SigningAuthority

_HINT: Final = "take another backup, and find out who made this one"
_TAKE_OVER: Final = "only to revoke what a newer list revokes: rossec ca refresh --list FILE"


@dataclass(frozen=True)
class Restored:
    """The result of a restore: the directory, and the number of log entries."""

    home: AuthorityHome
    entries: int
    restored_revocations: int  # revocations added from a newer list, or the replaced authority
    ended_phones: int = 0  # passkeys that could approve
    ended_domains: int = 0  # foreign domains that were trusted
    left_out: tuple[str, ...] = ()  # files of the backup that no part of rossec owns
    policy: str = ""  # whose policy is there: "of the backup", "of the replaced authority"


def back_up(home: AuthorityHome, passphrase: str) -> bytes:
    """Return a backup of the authority, encrypted with `passphrase`.

    Raises:
        PathRefused: another user could have written one of its files.
        BackupRefused: there is too much.
    """
    content = contents.kept(home.path)
    with contextlib.closing(home.store()) as store:
        content[RECORD] = store.database.snapshot()
    salt, nonce = secrets.token_bytes(backup.SALT_SIZE), secrets.token_bytes(backup.NONCE_SIZE)
    return backup.seal(content, passphrase, salt=salt, nonce=nonce)


def restore(
    home: Path,
    data: bytes,
    passphrase: str,
    now: int,
    *,
    secret: str | None = None,
    newest_list: bytes | None = None,
    entries: bytes | None = None,
    newest_domains: bytes | None = None,
    over: str | None = None,
    forget: int = 0,
    needs_list: bool = False,
    module: str | None = None,
    policy_of_backup: bool = False,
) -> Restored:
    """Restore an authority into ROSSEC_HOME `home`.

    Args:
        home: ROSSEC_HOME.
        data: the backup.
        passphrase: of the backup.
        now: the time.
        secret: the passphrase or PIN of the key, if it is another one.
        newest_list: a signed revocation list, or tree, that may be newer than the backup.
        entries: those of the tree, which does not contain them.
        newest_domains: a signed list of domains that may be newer than the backup.
        over: the trust domain of the authority that may be replaced.
        forget: the number of its log entries that the backup lacks, and that may be lost.
        needs_list: refuse to restore a root without `newest_list`.
        module: the PKCS#11 module of the token that has the key.
        policy_of_backup: its policy comes back also where the replaced authority has another.

    Raises:
        ConfigurationError: the authority's service runs.
        BackupRefused: not a backup, incomplete, or what was said does not match.
        RevocationRefused: the list, tree or entries are not the authority's.
        DomainsRefused: the list of domains is not, or is older than the backup.
        PassphraseRefused: the passphrase is wrong.
        TokenRefused: the operator does not name the module of the token that has the key.
        LogDamaged: the backup's own log does not verify.
    """
    said = _Said(over, forget, needs_list and newest_list is None, policy_of_backup)
    target = home / "ca"
    with _staging_beside(target) as staging:
        content, left = contents.restorable(backup.unseal(data, passphrase))
        uri = _settle_uri(content, home, module)
        _write(staging, content)
        authority = _open_verified(AuthorityHome(staging), secret or passphrase, uri)
        newer = restored_lists.read_newer(authority, newest_list, entries, newest_domains)
        done = _put_in_place(authority, target, newer, said, now)
    return replace(done, left_out=tuple(left))


@dataclass(frozen=True)
class _Said:
    """What the operator said: see `restore`."""

    over: str | None
    forget: int
    lacks_list: bool
    policy_of_backup: bool


@contextlib.contextmanager
def _staging_beside(target: Path) -> Iterator[Path]:
    """A new private directory, removed if it was not moved."""
    staging = target.with_name(f".ca.{secrets.token_hex(8)}")
    files.make_private_directory(staging)
    made = staging.stat().st_ino
    try:
        yield staging
    except BaseException:
        if staging.exists() and staging.stat().st_ino == made:
            shutil.rmtree(staging, ignore_errors=True)
        raise


def _put_in_place(
    authority: SigningAuthority, target: Path, newer: NewerLists, said: _Said, now: int
) -> Restored:
    """Replace what is at `target` by a verified authority, and let it begin anew."""
    staging, size = AuthorityHome(authority.path), authority.store.log.head(now).size
    with _locked(target):
        policy = "of the backup" if (staging.path / policyfile.NAME).exists() else ""
        if target.exists():
            _check_replacement(AuthorityHome(target), authority, said)
            newer = _with_what_is_known(AuthorityHome(target), newer)
            policy = _keep_what_stays(target, staging.path, policy, said)
        if said.lacks_list:
            restored_lists.require_list(authority, target.parent, now)
        if (uri := staging.key_uri()) is not None:
            token_modules.trust(target.parent, uri.module)
        phones, ended, revived = _begin_anew(authority, size, newer, now)
        _commit(staging.path, target, now)
    return Restored(AuthorityHome(target), size, revived, phones, ended, policy=policy)


def _settle_uri(content: dict[str, bytes], home: Path, module: str | None) -> KeyUri | None:
    """Where the key is, if it is in a token; the operator's module is in the file from now on."""
    if KEY_URI not in content:
        return None
    uri = token_modules.restored_uri(content[KEY_URI], home, module)
    content[KEY_URI] = f"{uri}\n".encode()
    return uri


def _commit(staging: Path, target: Path, now: int) -> None:
    """Put what is restored in its place in one step, and the authority that was there aside."""
    if not target.exists():
        files.commit_directory(staging, target)
        return
    paths = (target.with_name(f"ca.replaced.{number}") for number in count(now))
    aside = next(path for path in paths if not path.exists())
    files.replace_directory(staging, target, aside)


def _open_verified(staging: AuthorityHome, secret: str, uri: KeyUri | None) -> SigningAuthority:
    """The authority in a backup, if key, certificate and record are valid and match.

    Raises:
        BackupRefused: a part is missing or invalid.
        PassphraseRefused, LogDamaged: as `restore`.
    """
    try:
        key = staging.load_key(secret, () if uri is None else (uri.module,))
        authority = staging.open(key)
        authority.store.log.audit(authority.signer.public_key)
        authority.store.database.check()
        newest = authority.store.newest_list()
        if newest is not None and authority.authority.is_root:
            public = authority.authority.anchor.public_key
            open_tree(newest, public) if is_tree(newest) else open_list(newest, public)
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
        files.create(path, data, contents.mode(name))


def _keep_what_stays(target: Path, staging: Path, policy: str, said: _Said) -> str:
    """Let what an older one would bring back stay as it is here; returns whose policy it is."""
    for name in contents.staying(target):
        here, there = target / name, staging / name
        if name == policyfile.NAME:
            if said.policy_of_backup and there.exists():
                continue
            if not there.exists() or there.read_bytes() != here.read_bytes():
                policy = "of the replaced authority"
        files.make_private_directory(there.parent)
        there.unlink(missing_ok=True)
        if here.is_symlink():  # the operator's own file, elsewhere
            there.symlink_to(here.readlink())
        else:
            files.create(there, contents.read(target, name), contents.mode(name))
    return policy


def _check_replacement(there: AuthorityHome, found: SigningAuthority, said: _Said) -> None:
    """Refuse to replace an existing authority unless `said.over` and `said.forget` match."""
    anchor, held = _read(there)
    if anchor.thumbprint != found.authority.anchor.thumbprint:
        raise BackupRefused(
            f"the authority in {there.path} is not the one in the backup",
            "restore it into another ROSSEC_HOME",
        )
    if said.over != anchor.domain:
        listed = " --list FILE" if said.lacks_list else ""
        raise BackupRefused(
            f"there is an authority in {there.path}",
            f"{_TAKE_OVER}; to replace it with the backup: --over {there.domain}{listed}",
        )
    backed = found.store.log.entries()
    shared = sum(1 for ours, theirs in zip(held, backed, strict=False) if ours == theirs)
    lost = held[shared:]
    if len(lost) != said.forget:
        again = any(entry.what == RESTORED for entry in lost)
        reason = "it was restored here before" if again else "it is older"
        raise BackupRefused(
            f"the backup lacks {len(lost)} entries of the log in {there.path}",
            f"{reason}; {_TAKE_OVER}; to lose them permanently: --forget {len(lost)}",
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


def _with_what_is_known(there: AuthorityHome, newer: NewerLists) -> NewerLists:
    """Add what the authority that is replaced has revoked, and the epochs it has used."""
    with contextlib.closing(there.store()) as store:
        revoked = store.revoked_entries()
        epoch, domains_epoch = store.next_number()[0], store.domains.next_number()[0]
    return replace(
        newer,
        revoked=newer.revoked | revoked,
        epoch=max(newer.epoch, epoch),
        domains_epoch=max(newer.domains_epoch, domains_epoch),
    )


def _begin_anew(
    authority: SigningAuthority, entries: int, newer: NewerLists, now: int
) -> tuple[int, int, int]:
    """End what was open, start a new epoch, close the record.

    Returns how many passkeys and domains ended, and how many revocations came back.
    """
    with authority.store.transaction():
        phones = _end_what_was_open(authority, entries, now)
        ended = restored_lists.end_domains(authority, newer.domains, now)
        revived = restored_lists.start_new_epoch(authority, newer, now)
    authority.store.close()
    return phones, ended, revived


def _end_what_was_open(authority: SigningAuthority, entries: int, now: int) -> int:
    """Note the restore, and end what the backup does not know enough of; returns how many passkeys.

    Of an invitation's uses some may have been taken since, a passkey may have been removed, an
    approval been carried out, and a request that was approved been denied.
    """
    store = authority.store
    store.log_event(RESTORED, "record", f"from {entries} entries", now)
    store.invitations.end_all(restored_lists.RESTORED, now)
    store.approvals.end_waiting(restored_lists.RESTORED, now)
    for row in store.requests.open():
        if row.state is RequestState.APPROVED:
            at = min(now, row.expires)  # one that has expired may be open again: the clock is set
            store.requests.deny(row.digest, at, restored_lists.RESTORED)
    return store.passkeys.end_all(restored_lists.RESTORED, now)
