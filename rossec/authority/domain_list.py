"""The list of domains that the record calls for, and whether the newest one still is that.

It has the trusted foreign domains whose time is not over, and the keys of all valid identities with
a master's name. An authority without foreign domains and with one master signs none: its nodes then
work as they did before there were such lists. Once one was signed, there always is one.
"""

from typing import Final

from ca import svid
from ca.authority import Authority
from ca.certificates import TrustAnchor
from ca.domains.lists import DomainList, ForeignDomain, open_domains, sign_domains
from ca.keys.publickey import to_coordinates
from ca.store.record import Store

LIFETIME: Final = 90 * 86400
REFRESH: Final = 7 * 86400


def required_domains(store: Store, now: int) -> tuple[ForeignDomain, ...]:
    """The foreign domains that are trusted at `now`, sorted by name."""
    found = [row.read() for row in store.domains.accepted()]
    return tuple(each for each in found if now < each.until)


def required_masters(store: Store, now: int) -> tuple[bytes, ...]:
    """The keys of the domain's masters, as x and y, sorted."""
    rows = store.identities.valid_masters(now)
    return tuple(sorted({to_coordinates(svid.key_of(svid.parse(row.der))) for row in rows}))


def is_due(store: Store, anchor: TrustAnchor, now: int) -> bool:
    """Whether a list has to be signed: there is none, or it is old, or it says something else.

    Raises:
        DomainsRefused: the list in the record is not signed by the authority.
    """
    with store.database.read_transaction():
        data, domains = store.domains.newest_list(), required_domains(store, now)
        if not data:
            return bool(domains) or len({m.name for m in store.identities.valid_masters(now)}) > 1
        held = open_domains(data, anchor)
        said = held.domains, held.masters
        return now - held.issued > REFRESH or said != (domains, required_masters(store, now))


def sign(
    authority: Authority, store: Store, now: int, *, new_epoch: bool = False, above: int = 0
) -> DomainList:
    """Sign and record a list with the next number; `new_epoch`, `above`: as for a revocation list.

    Raises:
        DomainsRefused: there are too many domains or masters, or their terms are too long.
    """
    with store.transaction():
        epoch, seq = store.domains.next_number()
        if new_epoch:
            epoch, seq = max(epoch + 1, above + 1, now), 1
        listed = DomainList(
            epoch, seq, now, now + LIFETIME,
            required_domains(store, now), required_masters(store, now),
        )  # fmt: skip
        data = sign_domains(authority.signer, listed, authority.anchor.domain)
        store.domains.save_list(listed.number, data, now)
    return listed
