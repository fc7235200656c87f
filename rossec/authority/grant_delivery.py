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
from ca.errors import HintedError
from ca.revocation.state import open_statement
from grants import document
from grants.model import Grant
from rossec import files
from rossec.authority.home import AuthorityHome
from rossec.authority.master_call import MasterCall
from rossec.errors import ConfigurationError, NotDelivered
from rossec.home import NodeHome
from rossec.ros.text import printable

DEPOSIT_LIMIT: Final = 64  # grants in one call: the limit of the master
DEPOSIT_BYTES: Final = 512 * 1024  # in one call, of which the master takes 1 MiB with its envelope
STATES_LIMIT: Final = 256
DEPOSIT_SECONDS: Final = 15.0
STATES_SECONDS: Final = 3.0  # a list of grants must not wait for a master that is off

DIRECTORY: Final = "outgoing"  # in the authority's directory
OWNED: Final = (files.Owned(rf"{DIRECTORY}/[0-9a-f]{{1,128}}\.grant"),)
LATER: Final = "deliver it when the master runs: rossec grant deliver"
AGAIN: Final = "rossec grant deliver"
_AFTERWARDS: Final = f"afterwards deliver it with: {AGAIN}"


class RefusedDeposit(NamedTuple):
    """A grant that the master refuses, or that cannot be stored here, and why."""

    grant_id: bytes
    node: str
    reason: str
    is_here: bool = False
    hint: str = ""

    def say(self, grant: str) -> str:
        """One line about it, in which it is called `grant`."""
        if self.is_here:
            return f"{grant} of {self.node} cannot be stored here: {self.reason}"
        return f"the master refuses {grant} of {self.node}: {self.reason}"


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

    @abstractmethod
    def publish(self) -> None:
        """Deliver the newest list to the master. Raises `NotDelivered`, `ConfigurationError`."""

    @property
    def outgoing(self) -> Path:
        """The directory of grants that somebody carries to another domain."""
        return self.home.path / DIRECTORY

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

        What the master has already does no harm. One that lacks the newest list refuses every
        grant: it is given the list, and asked again. Returns those it refuses, and those that
        cannot be stored: the disk of one node keeps no other from its grants.

        Raises:
            NotDelivered: the master is out of reach; `rossec grant deliver` tries again.
        """
        everything, refused = [], list[RefusedDeposit]()
        for data in grants:
            failed = self.try_to_store(data)
            refused += [] if failed is None else [failed]
            if not is_alias(document.peek(data).subject):
                everything.append(data)
        for batch in _batches(everything):
            refused += self._deposit_with_list(batch)
        return refused

    def try_to_store(self, data: bytes) -> RefusedDeposit | None:
        """Store a grant where its node is in this home, or in `outgoing`; returns what failed."""
        grant = document.peek(data)
        try:
            if is_alias(grant.subject):
                files.make_private_directory(self.outgoing)
                files.replace(self.outgoing / f"{grant.id.hex()}.grant", data, 0o644)
            else:
                self.store_grant(data)
        except (HintedError, OSError) as error:  # of this node's directory
            reason = printable(getattr(error, "strerror", None) or str(error))
            return RefusedDeposit(grant.id, grant.subject, reason, is_here=True)
        return None

    def deposit_missing(self) -> tuple[int, list[RefusedDeposit]]:
        """Deposit every grant in force that the master does not have.

        Returns how many it has now besides, and those it refuses or that cannot be stored here.

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
        return len(missing) - sum(not each.is_here for each in refused), refused

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

    def master_has_list(self) -> bool:
        """Whether the list in force at the master is the newest that was signed here.

        Raises:
            ConfigurationError: none was signed here, or none that is valid.
            NotDelivered: the master does not answer, or is of a version that does not tell.
        """
        call = MasterCall(
            self.home.node(), "rossec.revocationStanding", (), "the question for its list",
            "rossec ca publish", within=DEPOSIT_SECONDS,
        )  # fmt: skip
        answer = self.deliver(call)
        newest = open_statement(self.home.revocation_list(), self.home.anchor().public_key)
        if self._now() >= newest.expires:
            raise ConfigurationError("the revocation list has expired", "rossec ca refresh")
        epoch, seq = newest.number
        return isinstance(answer, dict) and answer.get("list") == f"{epoch}.{seq}"

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

    def _deposit_with_list(self, batch: list[bytes]) -> list[RefusedDeposit]:
        refused = self._deposit(batch)
        if not refused:
            return []
        try:
            lacking = not self.master_has_list()
            if lacking:
                self.publish()
        except (ConfigurationError, NotDelivered) as error:
            hint = f"{error.hint}; {_AFTERWARDS}" if error.hint else _AFTERWARDS
            return [each._replace(hint=hint) for each in refused]
        if not lacking:
            return refused
        ids = {each.grant_id for each in refused}
        return self._deposit([data for data in batch if document.grant_id(data) in ids])

    def _deposit(self, batch: list[bytes]) -> list[RefusedDeposit]:
        reasons = self._ask("rossec.depositGrants", batch, DEPOSIT_SECONDS)
        return [
            RefusedDeposit(grant.id, grant.subject, printable(reason), hint=_AFTERWARDS)
            for data, reason in zip(batch, reasons, strict=True)
            if reason
            for grant in (document.peek(data),)
        ]


def require_delivered(refused: Iterable[RefusedDeposit]) -> None:
    """Return if the master has every grant; of those it has, a copy here is not needed.

    Raises:
        NotDelivered: it refuses some, each of which was said.
    """
    lacking = [each for each in refused if not each.is_here]
    if lacking:
        grants = "1 grant is" if len(lacking) == 1 else f"{len(lacking)} grants are"
        raise NotDelivered(f"{grants} signed, but not delivered", lacking[0].hint or LATER)


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
