"""Back up an authority into one file, and restore it without losing data by accident.

What is in a backup, each part of rossec says that writes files, in its `OWNED`: a test holds every
file of a home that has used all of them against this. The backup lacks what was signed after it, so a
new epoch of lists begins, and signed lists from the master or a node give back what is missing
(`restored_lists`).
"""

import contextlib
import re
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Final

from ca.certificates import TrustAnchor
from ca.errors import CAError, HintedError, LogDamaged, PassphraseRefused
from ca.keys import passphrases, private_keys
from ca.revocation.lists import is_tree, open_list, open_tree
from ca.store import log, values
from rossec import files, home, saved_statements
from rossec.authority import grant_operations, policyfile, renewals, requests, restored_lists, signing
from rossec.authority import home as authority_home
from rossec.authority.console import messages as console
from rossec.authority.home import KEY_URI, RECORD, AuthorityHome
from rossec.authority.keyservice import client
from rossec.authority.signing import SigningAuthority
from rossec.errors import ConfigurationError
from rossec.files import Owned, read_own

_NODE: Final = (
    *home.OWNED,
    *saved_statements.OWNED,
    *(each.below(home.FILTERS) for each in home.FILTER_KEYS),
)
OWNED: Final[tuple[Owned, ...]] = (
    *authority_home.OWNED,
    *renewals.OWNED,
    *signing.OWNED,
    *policyfile.OWNED,
    *requests.OWNED,
    *grant_operations.OWNED,
    *client.OWNED,
    *console.OWNED,
    *(each.below(authority_home.NODE) for each in _NODE),
)
# Older versions put every file there is into a backup, of these places.
_OLDER: Final = re.compile(r"(?:node/|inbox/)?[^/]+")
_TEMPORARY: Final = re.compile(r"(?:.+/)?\.[^/]+")  # of `files.replace`, when it was interrupted


def owner(name: str) -> Owned | None:
    """What its owner says of the file `name`; None: nobody does."""
    return next((each for each in OWNED if each.names(name)), None)


def undeclared(directory: Path) -> list[str]:
    return [name for name in _files(directory) if owner(name) is None]


def kept(directory: Path) -> dict[str, bytes]:
    found = ((name, owner(name)) for name in _files(directory) if name != RECORD)
    return {name: read(directory, name) for name, owned in found if owned is not None and owned.kept}


def staying(directory: Path) -> list[str]:
    """The files of an authority's directory that a backup does not replace."""
    found = ((name, owner(name)) for name in _files(directory))
    return [name for name, owned in found if owned is not None and owned.stays]


def read(directory: Path, name: str) -> bytes:
    gone = ConfigurationError(f"{directory / name} was removed meanwhile", "do it again")
    return read_own(directory / name, passphrases.MAX_BACKUP, gone, link=name == policyfile.NAME)


def restorable(content: Mapping[str, bytes]) -> tuple[dict[str, bytes], list[str]]:
    """The files of a backup that are written, and the names of those that are left out."""
    # A backup is of whoever made it: only what a part of rossec says is its own, and is kept in backups, is
    # written. An older version may have taken other files along from some places.
    found = {name: owner(name) for name in content}
    for name, owned in found.items():
        if owned is None and not _OLDER.fullmatch(name):
            raise CAError(f"{name!a} is not a file of an authority")
    taken = {name for name, owned in found.items() if owned is not None and owned.kept}
    left = sorted(found.keys() - taken)
    return {name: data for name, data in content.items() if name in taken}, left


def mode(name: str) -> int:
    found = owner(name)
    return 0o644 if found is not None and found.public else 0o600


def _files(directory: Path) -> Iterable[str]:
    for path in sorted(directory.rglob("*")):
        name = str(path.relative_to(directory))
        if path.is_file() and _TEMPORARY.fullmatch(name) is None:
            yield name


_TAKE_OVER: Final = "only to revoke what a newer list revokes: rossec ca refresh --list FILE"


@dataclass(frozen=True)
class Restored:
    home: AuthorityHome
    entries: int
    restored_revocations: int  # revocations added from a newer list, or the replaced authority
    ended_phones: int = 0  # passkeys that could approve
    ended_domains: int = 0  # foreign domains that were trusted
    left_out: tuple[str, ...] = ()  # files of the backup that no part of rossec owns
    policy: str = ""  # whose policy is there: "of the backup", "of the replaced authority"


def back_up(home: AuthorityHome, passphrase: str) -> bytes:
    content = kept(home.path)
    with contextlib.closing(home.store()) as store:
        content[RECORD] = store.database.snapshot()
    salt, nonce = map(secrets.token_bytes, (passphrases.SALT_SIZE, passphrases.NONCE_SIZE))
    return passphrases.seal(content, passphrase, salt=salt, nonce=nonce)


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
    said = _Said(over, forget, needs_list and newest_list is None, policy_of_backup)
    target = home / "ca"
    with _staging_beside(target) as staging:
        # 1. Written next to the target, where nothing uses it.
        content, left = restorable(passphrases.unseal(data, passphrase))
        uri = None
        if KEY_URI in content:
            uri = authority_home.restored_uri(content[KEY_URI], home, module)
            content[KEY_URI] = f"{uri}\n".encode()
        for name, part in content.items():
            path = staging / name
            files.make_private_directory(path.parent)
            files.create(path, part, mode(name))
        # 2. The key opens and is that of the certificate, the log and the newest list verify.
        authority = _open_verified(AuthorityHome(staging), secret or passphrase, uri)
        # 3. What is newer than the backup is taken over, and the authority put in its place.
        newer = restored_lists.read_newer(authority, newest_list, entries, newest_domains)
        done = _put_in_place(authority, target, newer, said, now)
    return replace(done, left_out=tuple(left))


@dataclass(frozen=True)
class _Said:
    over: str | None
    forget: int
    lacks_list: bool
    policy_of_backup: bool


@contextlib.contextmanager
def _staging_beside(target: Path) -> Iterator[Path]:
    # A new private directory, removed if it was not moved.
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
    authority: SigningAuthority, target: Path, newer: restored_lists.NewerLists, said: _Said, now: int
) -> Restored:
    staging, size = AuthorityHome(authority.path), authority.store.log.head(now).size
    # Neither a service nor a command may change what is compared, until it was replaced.
    with _locked(target):
        policy = "of the backup" if (staging.path / policyfile.NAME).exists() else ""
        if target.exists():
            _check_replacement(AuthorityHome(target), authority, said)
            there = AuthorityHome(target)
            with contextlib.closing(there.store()) as store:
                revoked = store.revoked_entries()
                epoch, domains_epoch = store.next_number()[0], store.domains.next_number()[0]
            newer = replace(
                newer,
                revoked=newer.revoked | revoked,
                epoch=max(newer.epoch, epoch),
                domains_epoch=max(newer.domains_epoch, domains_epoch),
            )
            policy = _keep_what_stays(target, staging.path, policy, said)
        if said.lacks_list:
            restored_lists.require_list(authority, target.parent, now)
        if (uri := staging.key_uri()) is not None:
            authority_home.trust(target.parent, uri.module)
        phones, ended, revived = _begin_anew(authority, size, newer, now)
        # In one step: cut off before it, all is as it was (ADR 0050).
        if target.exists():
            paths = (target.with_name(f"ca.replaced.{number}") for number in count(now))
            files.replace_directory(staging.path, target, next(path for path in paths if not path.exists()))
        else:
            files.commit_directory(staging.path, target)
    return Restored(AuthorityHome(target), size, revived, phones, ended, policy=policy)


def _open_verified(staging: AuthorityHome, secret: str, uri: private_keys.KeyUri | None) -> SigningAuthority:
    try:
        # Of modules only the one that the operator named is run (`backup-runs-code`).
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
        raise CAError(
            f"the backup does not contain a valid authority: {reason}",
            "take another backup, and find out who made this one",
        ) from error
    return authority


@contextlib.contextmanager
def _locked(target: Path) -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        if target.is_dir() and not target.is_symlink():  # nothing is written behind a link
            stack.enter_context(client.service_lock(target))
        with contextlib.suppress(HintedError):  # an incomplete authority: `_read` reports it
            store = stack.enter_context(contextlib.closing(AuthorityHome(target).store()))
            stack.enter_context(store.transaction())
        yield


def _keep_what_stays(target: Path, staging: Path, policy: str, said: _Said) -> str:
    # Let what an older one would bring back stay as it is here; returns whose policy it is.
    for name in staying(target):
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
            files.create(there, read(target, name), mode(name))
    return policy


def _check_replacement(there: AuthorityHome, found: SigningAuthority, said: _Said) -> None:
    anchor, held = _read(there)
    if anchor.thumbprint != found.authority.anchor.thumbprint:
        raise CAError(
            f"the authority in {there.path} is not the one in the backup",
            "restore it into another ROSSEC_HOME",
        )
    if said.over != anchor.domain:
        listed = " --list FILE" if said.lacks_list else ""
        raise CAError(
            f"there is an authority in {there.path}",
            f"{_TAKE_OVER}; to replace it with the backup: --over {there.domain}{listed}",
        )
    # Newer entries of the log are lost only if the operator says how many; what was revoked stays revoked.
    backed = found.store.log.entries()
    shared = sum(1 for ours, theirs in zip(held, backed, strict=False) if ours == theirs)
    lost = held[shared:]
    if len(lost) != said.forget:
        again = any(entry.what == log.RESTORED for entry in lost)
        reason = "it was restored here before" if again else "it is older"
        raise CAError(
            f"the backup lacks {len(lost)} entries of the log in {there.path}",
            f"{reason}; {_TAKE_OVER}; to lose them permanently: --forget {len(lost)}",
        )


def _read(there: AuthorityHome) -> tuple[TrustAnchor, list[values.LogEntry]]:
    try:
        with contextlib.closing(there.store()) as store:
            return there.anchor(), store.log.entries()
    except HintedError as error:
        raise CAError(
            f"the authority in {there.path} is incomplete: {error}",
            "move that directory away and restore again: its log cannot be compared",
        ) from error


def _begin_anew(
    authority: SigningAuthority, entries: int, newer: restored_lists.NewerLists, now: int
) -> tuple[int, int, int]:
    # Returns how many passkeys and domains ended, and how many revocations came back.
    with authority.store.transaction():
        # What the backup does not know enough of ends (`restored-approval`). Of an invitation's uses some
        # may have been taken since, a passkey may have been removed, an approval
        # been carried out, and a request that was approved been denied.
        store = authority.store
        store.log_event(log.RESTORED, "record", f"from {entries} entries", now)
        store.invitations.end_all(restored_lists.RESTORED, now)
        store.approvals.end_waiting(restored_lists.RESTORED, now)
        for row in store.requests.open():
            if row.state is values.RequestState.APPROVED:
                at = min(now, row.expires)  # one that has expired may be open again: the clock is set
                store.requests.deny(row.digest, at, restored_lists.RESTORED)
        phones = store.passkeys.end_all(restored_lists.RESTORED, now)
        ended = restored_lists.end_domains(authority, newer.domains, now)
        revived = restored_lists.start_new_epoch(authority, newer, now)
    authority.store.close()
    return phones, ended, revived
