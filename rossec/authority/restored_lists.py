"""What a restored record lacks, from lists that are newer: revocations, and domains trusted.

A list says all that was revoked when it was signed, so it gives back what a backup has lost, on a
restore or later. A list of domains is taken the other way round: trust that the newest list does
not name may have been withdrawn, so it ends.
"""

import contextlib
import shlex
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ca.certificates import TrustAnchor
from ca.domains import ForeignDomain, open_domains
from ca.errors import CAError, DomainsRefused, HintedError
from ca.revocation import lists, trust_status
from rossec import files
from rossec.authority.home import ENTRIES
from rossec.authority.signing import SigningAuthority
from rossec.home import REVOCATIONS, NodeHome
from rossec.ros.names import MASTER

RESTORED: Final = "restored from a backup"
NEWER: Final = "from a list newer than the backup"


@dataclass(frozen=True)
class NewerLists:
    """`revoked`: entries that are revoked. `domains`: the foreign domains that are trusted. `epoch`,
    `domains_epoch`: the last that lists are known to have.
    """

    revoked: frozenset[bytes] = frozenset()
    domains: tuple[ForeignDomain, ...] = ()
    epoch: int = 0
    domains_epoch: int = 0


def read_files(path: Path, entries: Path | None) -> tuple[bytes, bytes | None]:
    beside = path.with_name(ENTRIES)
    if entries is None and beside.exists():
        entries = beside
    listed = files.read(path, lists.MAX_LIST)
    return listed, None if entries is None else files.read(entries, lists.MAX_TREE_ENTRIES_SIZE)


def read_newer(
    authority: SigningAuthority,
    newest_list: bytes | None,
    entries: bytes | None,
    newest_domains: bytes | None,
) -> NewerLists:
    anchor = authority.authority.anchor
    revoked, epoch = read_revoked(newest_list, entries, anchor)
    held = authority.store.newest_list()
    if newest_list is not None and held is not None:
        found = trust_status.open_statement(newest_list, anchor.public_key)
        if found.number < trust_status.open_statement(held, anchor.public_key).number:
            raise CAError(
                "the list is older than the backup: it says nothing of what was revoked since",
                "give a newer one: the master has the newest",
            )
    domains, domains_epoch = read_domains(newest_domains, authority)
    return NewerLists(revoked, domains, epoch, domains_epoch)


def require_list(authority: SigningAuthority, home: Path, now: int) -> None:
    if not authority.authority.is_root:
        return
    here = newest_here(home, authority.authority.anchor)
    if here is not None:
        where = f"the newest here: --list {shlex.quote(str(here))}; the master may have a newer one"
    else:
        masters = [row.name for row in authority.store.identities.valid_masters(now)]
        there = NodeHome.of(Path("ROSSEC_HOME"), min(masters, default=MASTER)).path
        where = (
            f"every node has one, the master the newest: scp 'HOST:{there}/revocations.*' ."
            f" and --list {REVOCATIONS}"
        )
    raise CAError(
        "without a newer list, what was revoked after the backup would be valid again",
        f"{where}; only if none is left: --without-list",
    )


def newest_here(home: Path, anchor: TrustAnchor) -> Path | None:
    """The newest list of the authority that a node in ROSSEC_HOME `home` has; None: none has one."""
    # A tree counts only with its entries beside it.
    found = []
    for path in sorted(home.glob(f"nodes/*/{REVOCATIONS}")):
        with contextlib.suppress(HintedError, OSError):  # another authority's, or damaged
            data = files.read(path, lists.MAX_LIST)
            statement = trust_status.open_statement(data, anchor.public_key)
            if not lists.is_tree(data) or path.with_name(ENTRIES).exists():
                found.append((statement.number, path))
    return max(found)[1] if found else None


def read_revoked(
    data: bytes | None, entries: bytes | None, anchor: TrustAnchor
) -> tuple[frozenset[bytes], int]:
    if data is None:
        return frozenset(), 0
    if not lists.is_tree(data):
        listed = lists.open_list(data, anchor.public_key)
        return listed.entries, listed.epoch
    tree = lists.open_tree(data, anchor.public_key)
    if entries is None:
        raise CAError(
            "the newest revocations are a tree, which does not contain its entries",
            "give its entries with --entries: the master has them in revocations.entries",
        )
    listing = lists.TreeEntries.read(entries)
    listing.check(tree)
    return listing.entries, tree.epoch


def read_domains(data: bytes | None, authority: SigningAuthority) -> tuple[tuple[ForeignDomain, ...], int]:
    """The domains that a signed list names, and its epoch; none without one."""
    if data is None:
        return (), 0
    anchor = authority.authority.anchor
    found, held = open_domains(data, anchor), authority.store.domains.newest_list()
    if held and found.number < open_domains(held, anchor).number:
        raise DomainsRefused("the list of domains is older than the backup", "give a newer one")
    return found.domains, found.epoch


def end_domains(authority: SigningAuthority, newest: Collection[ForeignDomain], now: int) -> int:
    """Trust the domains of the newest list, with its terms; returns how many are trusted no more."""
    # One may have been removed since the backup: without a list, none is trusted.
    domains, wanted = authority.store.domains, {each.terms: each for each in newest}
    ended = [row for row in domains.accepted() if row.terms not in wanted]
    for row in ended:
        domains.end(row.label, RESTORED, now)
    held = {row.terms for row in domains.accepted()}
    for terms, each in wanted.items():
        if terms not in held:
            domains.accept(each, now)
    named = {each.domain for each in newest}
    return sum(row.domain not in named for row in ended)


def start_new_epoch(authority: SigningAuthority, newer: NewerLists, now: int) -> int:
    """Revoke what is missing and sign lists of a new epoch; an intermediate has neither."""
    # Returns how many revocations were missing.
    if not authority.authority.is_root:
        return 0
    with authority.store.transaction():
        missing = _revoke_missing(authority, newer.revoked, now)
        authority.sign_list(now, new_epoch=True, above=newer.epoch)
        if authority.store.domains.newest_list() or authority.store.domains.accepted():
            authority.sign_domains(now, new_epoch=True, above=newer.domains_epoch)
    return missing


def take_over(
    authority: SigningAuthority, data: bytes, entries: bytes | None, now: int
) -> tuple[lists.RevocationList, int]:
    """Revoke what a list from before a restore revokes; returns the new list, and how many."""
    # It is for a record that lacks revocations, and can be done at any time: it only takes away. If the
    # list has a later epoch than the record, the new list has one after that.
    revoked, epoch = read_revoked(data, entries, authority.authority.anchor)
    with authority.store.transaction():
        missing = _revoke_missing(authority, revoked, now)
        held, _ = authority.store.next_number()
        listed = authority.sign_list(now, new_epoch=epoch > held, above=epoch)
    return listed, missing


def _revoke_missing(authority: SigningAuthority, revoked: frozenset[bytes], now: int) -> int:
    missing = revoked - authority.store.revoked_entries()
    for entry in sorted(missing):
        authority.store.revoke(entry, NEWER, now)
    return len(missing)
