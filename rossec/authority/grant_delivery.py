"""How signed grants reach their nodes, as methods of `AuthorityService`.

A node whose directory is in this ROSSEC_HOME gets a file; every other fetches its grants from the
master, where they are deposited (docs/spec/master.md). No passphrase is needed: the master accepts
deposits from the authority's own node, and the grants are signed.
"""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from ca.domains.aliases import is_alias
from grants import document
from grants.model import Grant
from rossec import files
from rossec.authority.home import AuthorityHome
from rossec.authority.master_call import MasterCall
from rossec.errors import NotDelivered
from rossec.home import NodeHome
from rossec.ros.text import printable

DEPOSIT_LIMIT: Final = 64  # grants in one call: the limit of the master
DEPOSIT_BYTES: Final = 512 * 1024  # in one call, of which the master takes 1 MiB with its envelope
STATES_LIMIT: Final = 256
DEPOSIT_SECONDS: Final = 15.0
STATES_SECONDS: Final = 3.0  # a list of grants must not wait for a master that is off

LATER: Final = "deliver it when the master runs: rossec grant deliver"


class RefusedDeposit(NamedTuple):
    """A grant that the master refuses, and why."""

    grant_id: bytes
    node: str
    reason: str


class GrantDelivery(ABC):
    """The methods of `AuthorityService` that deliver grants; `_now` returns seconds.

    `rossec_home` is ROSSEC_HOME.
    """

    rossec_home: Path
    _now: Callable[[], int]

    @property
    @abstractmethod
    def home(self) -> AuthorityHome:
        """The directory of the authority, if there is one."""

    @abstractmethod
    def deliver(self, call: MasterCall) -> object:
        """Make a call at the master; returns the value of its answer. Raises `NotDelivered`."""

    @property
    def outgoing(self) -> Path:
        """The directory of grants that somebody carries to another domain."""
        return self.home.path / "outgoing"

    def store_grant(self, data: bytes) -> Path | None:
        """Store a grant in its node's directory if that is in this home; returns the directory."""
        grant = document.peek(data)
        home = NodeHome.of(self.rossec_home, grant.subject)
        if not home.path.is_dir():
            return None
        home.add_grant(grant.id, data)
        return home.path

    def deposit(self, grants: Iterable[bytes]) -> list[RefusedDeposit]:
        """Deliver grants: deposit each at the master, and store it where its node is in this home.

        Those of nodes of other domains, who ask another master, are put into `outgoing`.

        What the master has already does no harm. Returns those it refuses.

        Raises:
            NotDelivered: the master is out of reach; `rossec grant deliver` tries again.
        """
        everything = []
        for data in grants:
            grant = document.peek(data)
            if is_alias(grant.subject):
                files.make_private_directory(self.outgoing)
                files.replace(self.outgoing / f"{grant.id.hex()}.grant", data, 0o644)
                continue
            self.store_grant(data)
            everything.append(data)
        return [refused for batch in _batches(everything) for refused in self._deposit(batch)]

    def deposit_missing(self) -> tuple[int, list[RefusedDeposit]]:
        """Deposit every grant in force that the master does not have.

        Returns how many it has now besides, and those it refuses.

        Raises:
            NotDelivered: the master is out of reach.
        """
        states = self.delivery_states(within=DEPOSIT_SECONDS)
        missing = [
            data
            for grant, data in self._in_force()
            if not states.get(grant.id) and not is_alias(grant.subject)
        ]
        refused = self.deposit(missing)
        return len(missing) - len(refused), refused

    def delivery_states(self, within: float = STATES_SECONDS) -> dict[bytes, str]:
        """What the master says of each grant in force, by its id.

        `held` (the node has presented it), `fetched`, `waiting`, or empty: the master does not
        have it.

        Raises:
            NotDelivered: the master did not answer `within` seconds, or is of an older version.
        """
        ids = [(grant.id, grant.holder) for grant, _ in self._in_force()]
        states: dict[bytes, str] = {}
        for begin in range(0, len(ids), STATES_LIMIT):
            chunk = ids[begin : begin + STATES_LIMIT]
            entries = [grant_id + holder for grant_id, holder in chunk]
            answer = self._ask("rossec.deliveryStates", entries, within)
            states |= zip((grant_id for grant_id, _ in chunk), answer, strict=True)
        return states

    def _deposit(self, batch: list[bytes]) -> list[RefusedDeposit]:
        reasons = self._ask("rossec.depositGrants", batch, DEPOSIT_SECONDS)
        return [
            RefusedDeposit(grant.id, grant.subject, printable(reason))
            for data, reason in zip(batch, reasons, strict=True)
            if reason
            for grant in (document.peek(data),)
        ]

    def _ask(self, method: str, items: list[bytes], within: float) -> list[str]:
        """The text that the master answers for each item."""
        what = "the grants" if len(items) != 1 else "the grant"
        call = MasterCall(self.home.node(), method, (items,), what, LATER, within=within)
        answer = self.deliver(call)
        values = answer if isinstance(answer, list) else []
        texts = [item for item in values if isinstance(item, str)]
        if len(texts) != len(items):
            raise NotDelivered(f"the master's answer about {what} is malformed", LATER)
        return texts

    def _in_force(self) -> Iterator[tuple[Grant, bytes]]:
        """The grants that a node can use now or after a renewal, the oldest first."""
        now = self._now()
        with contextlib.closing(self.home.store()) as store:
            rows, revoked = store.grants(), store.revoked_entries()
        for row in rows:
            grant = document.peek(row.data)
            if now < grant.cap and revoked.isdisjoint((grant.id, grant.holder)):
                yield grant, row.data


def _batches(grants: Iterable[bytes]) -> Iterator[list[bytes]]:
    """The grants in calls that the master takes."""
    batch: list[bytes] = []
    size = 0
    for data in grants:
        if len(batch) == DEPOSIT_LIMIT or (batch and size + len(data) > DEPOSIT_BYTES):
            yield batch
            batch, size = [], 0
        batch.append(data)
        size += len(data)
    if batch:
        yield batch
