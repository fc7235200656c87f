"""What an authority does about foreign domains, as methods of `AuthorityService`.

Terms are recorded and the list signed in one transaction. A label that grants name is not given to
another domain while one of these can live: they would then speak of its nodes. Whoever has another
root key is another domain, whatever it is called.
"""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final, NamedTuple

from ca.domains.aliases import split_alias
from ca.domains.cards import LIFETIME, Card, sign_card
from ca.domains.lists import DomainList, ForeignDomain
from ca.errors import DomainUnknown
from ca.revocation.state import RevocationList
from ca.store.domains import DomainRow
from ca.store.record import GrantRow, Store
from grants import document
from rossec.authority import foreign_nodes
from rossec.authority.home import AuthorityHome
from rossec.authority.master_call import MasterCall
from rossec.authority.signing import SKEW, SigningAuthority
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.ros.names import UPDATE_DOMAINS

_PUBLISH: Final = (
    "the list of domains is signed and stored, but takes effect only when the master has it;"
    " deliver it with: rossec ca publish"
)


class Removed(NamedTuple):
    """A domain that is not trusted any more, and the ids of its grants that were revoked."""

    row: DomainRow
    revoked: frozenset[bytes]


class DomainOperations(ABC):
    """The methods of `AuthorityService` about domains; `_now` returns seconds since the epoch."""

    _now: Callable[[], int]

    @property
    @abstractmethod
    def home(self) -> AuthorityHome:
        """The directory of the authority, if there is one."""

    @abstractmethod
    def unlock(self) -> SigningAuthority:
        """The authority with its key."""

    @abstractmethod
    def deliver(self, call: MasterCall) -> object:
        """Make a call at the master; returns the value of its answer. Raises `NotDelivered`."""

    def domain_card(
        self, names: tuple[str, ...], masters: tuple[str, ...] = (), lifetime: int = LIFETIME
    ) -> bytes:
        """Sign a card of this domain, for another authority.

        Raises:
            CardRefused, PatternRefused: it would not be one.
        """
        authority, at = self.unlock(), self._now()
        root = authority.authority.anchor.certificate
        return sign_card(authority.signer, Card(root, names, masters, at, at + lifetime))

    def accept_domain(self, domain: ForeignDomain) -> DomainList:
        """Trust a domain, or change the terms of one that is trusted; returns the new list.

        Raises:
            ConfigurationError: a grant can live that names its label for another domain.
            StoreError: another domain has its label or root key.
            DomainsRefused: it is the own domain, or there are too many.
        """
        authority, at = self.unlock(), self._now()
        with authority.store.transaction():
            authority.store.domains.accept(domain, at)
            check_label_free(authority.store, domain, at)
            return authority.sign_domains(at)

    def changed_domain(self, label: str, **changes: Any) -> ForeignDomain:
        """What the terms of a trusted domain would be; see `limit_domain`."""
        with contextlib.closing(self.home.store()) as store:
            return replace(store.domains.get(label).read(), **changes)

    def limit_domain(self, label: str, **changes: Any) -> DomainList:
        """Change fields of the terms of a trusted domain; returns the new list.

        Raises:
            DomainUnknown: no domain is trusted under this label.
            CAError: the terms would not be in form.
        """
        authority, at = self.unlock(), self._now()
        with authority.store.transaction():
            held = authority.store.domains.get(label).read()
            authority.store.domains.accept(replace(held, **changes), at)
            return authority.sign_domains(at)

    def remove_domain(self, label: str, reason: str, *, revoke_grants: bool) -> Removed:
        """End the trust in a domain; with `revoke_grants`, also every grant for its nodes.

        Raises:
            DomainUnknown: no domain is trusted under this label.
        """
        authority, at = self.unlock(), self._now()
        with authority.store.transaction():
            row = authority.store.domains.end(label, reason, at)
            given = living_grants(authority.store, label, at) if revoke_grants else []
            revoked = frozenset(grant.id for grant in given)
            if revoked:
                authority.revoke_all(revoked, f"domain {label} was removed", at)
            authority.sign_domains(at)
        return Removed(row, revoked)

    def revoke_foreigner(
        self, alias: str, reason: str, certificate: bytes = b""
    ) -> tuple[RevocationList, int]:
        """Revoke keys of a node of another domain here; returns the list, and their number.

        All that are recorded, or the one in `certificate` (PEM), which is recorded with it. It
        needs nothing from the other domain, whose trust may have ended.

        Raises:
            DomainUnknown: no domain has the label.
            NotAdmitted, CertificateRefused: as `foreign_nodes.verify`.
            ConfigurationError: there is no key to revoke, or the certificate is another node's.
        """
        authority, at = self.unlock(), self._now()
        store = authority.store
        with store.transaction():
            if certificate:
                identity, root = foreign_nodes.verify(store, alias, certificate, at)
                store.domains.add_certificate(root, identity, at)
                keys = frozenset({identity.thumbprint})
            else:
                label, _ = foreign_nodes.split(alias)
                root = find_row(store, label).root
                keys = foreign_nodes.unrevoked_keys(store, root, alias)
            return authority.revoke_all(keys, reason, at), len(keys)

    def publish_domains(self) -> bool:
        """Deliver the newest list of domains to the master; whether there is one.

        Raises:
            ConfigurationError: it has expired.
            NotDelivered: the master is out of reach, or refuses it.
        """
        home, at = self.home, self._now()
        found = home.domain_list()
        if found is None:
            return False
        data, listed = found
        if at >= listed.expires:
            raise ConfigurationError(
                f"the list of domains expired {format_time(listed.expires)}",
                "sign it anew with: rossec ca refresh",
            )
        self.deliver(
            MasterCall(home.node(), UPDATE_DOMAINS, (data,), "the list of domains", _PUBLISH)
        )
        return True


def living_grants(store: Store, label: str, now: int) -> list[GrantRow]:
    """The grants for nodes of the domain `label` that are not revoked and can be valid yet."""
    return [
        row
        for row in store.unrevoked_grants()
        if (found := split_alias(row.name)) is not None
        and found[0] == label
        and document.peek(row.data).cap + SKEW >= now
    ]


def check_label_free(store: Store, domain: ForeignDomain, now: int) -> None:
    """Return if no grant can live that names the label of `domain` and means another one.

    Raises:
        ConfigurationError: one can.
    """
    root = domain.anchor.thumbprint
    former = [row for row in store.domains.labelled(domain.label) if row.root != root]
    if not former:
        return
    given = living_grants(store, domain.label, now)
    if given:
        last = max(document.peek(row.data).cap for row in given)
        count = f"{len(given)} grants name" if len(given) > 1 else "a grant names"
        raise ConfigurationError(
            f"{count} {domain.label} and mean{'s' * (len(given) == 1)} {former[-1].domain},"
            f" until {format_time(last)}",
            f"choose another label, or revoke: rossec grant revoke {given[0].id.hex()[:8]}",
        )


def find_row(store: Store, label: str) -> DomainRow:
    """The trusted domain with this label, or the last one that had it.

    Raises:
        DomainUnknown: there never was one.
    """
    try:
        return store.domains.get(label)
    except DomainUnknown:
        former = store.domains.labelled(label)
        if not former:
            raise
        return former[-1]
