"""What the authority does about constrained things, as methods of `AuthorityService`.

A statement, the identity that goes with it, and the end of what it replaces are one transaction:
signed and recorded together, or not at all. A statement reaches its border router as a file, or at
once where that router's directory is in this ROSSEC_HOME.
"""

import contextlib
import secrets
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from ca.certificates import check_request
from ca.errors import ThingRefused
from ca.revocation.state import RevocationList
from ca.store.things import ThingRow
from ca.things.credentials import Credential
from ca.things.statement import ThingStatement, peek_statement, sign_statement
from rossec.authority import thing_records
from rossec.authority.home import AuthorityHome
from rossec.authority.signing import SKEW, SigningAuthority
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.saved_things import ThingFiles

SERIAL: Final = 16


@dataclass(frozen=True)
class ThingOrder:
    """What is to be stated.

    Args:
        name: of the thing, and of the node that stands for it.
        border: the name of the border router that serves it.
        credential: how the thing proves who it is.
        lifetime: of the statement, seconds.
        replaced: names of things whose statements end by this one.
        request: for the identity of the node (DER), if it is to be signed as well.
        identity_lifetime: of that identity, seconds.
    """

    name: str
    border: str
    credential: Credential
    lifetime: int
    replaced: frozenset[str] = frozenset()
    request: bytes = b""
    identity_lifetime: int = 0


class SignedThing(NamedTuple):
    """What was signed: the statement, its octets, and the bundle of the identity (PEM) if any."""

    statement: ThingStatement
    data: bytes
    bundle: bytes
    revoked: int


class ThingOperations(ABC):
    """The methods of `AuthorityService` about things; `_now` returns seconds since the epoch.

    `rossec_home` is ROSSEC_HOME.
    """

    rossec_home: Path
    _now: Callable[[], int]

    @property
    @abstractmethod
    def home(self) -> AuthorityHome:
        """The directory of the authority, if there is one."""

    @abstractmethod
    def unlock(self) -> SigningAuthority:
        """The authority with its key."""

    def sign_thing(self, order: ThingOrder) -> SignedThing:
        """State what a thing is, and certify its node if there is a request.

        Raises:
            ThingChanged: another thing in force has the name, the credential or the kid.
            ThingUnknown: there is nothing about a name in `replaced`.
            ThingRefused, NameRefused: the name is not one for a thing, or its router's.
            StoreError: the router has no valid identity, or a key is revoked or taken.
            RequestRefused: not a request.
            ConfigurationError: the request is of another node, or this is an intermediate.
        """
        authority, at = self.unlock(), self._now()
        if not authority.authority.is_root:
            raise ConfigurationError("an intermediate cannot say what a thing is", "at the root")
        if order.name == order.border:
            raise ThingRefused(
                f"{order.name} is the border router, and no thing of its own",
                "a thing has a name of its own: /things/lamp",
            )
        store = authority.store
        with store.transaction():
            router = store.valid_certificate(order.border, at)
            store.identities.check_not_revoked(order.name, order.credential.thumbprint)
            statement = ThingStatement(
                authority.domain, order.name, order.credential, router.thumbprint,
                at - SKEW, at + order.lifetime, secrets.token_bytes(SERIAL),
            )  # fmt: skip
            ended = thing_records.replaced_by(
                store, order.name, router.thumbprint, order.replaced, at
            )
            bundle = _certify(authority, order, at)
            ended -= _key_of(authority, order)
            if ended:
                authority.revoke_all(ended, f"replaced by {order.name}", at)
            authority.refresh_list(at)
            data = sign_statement(authority.signer, statement)
            row = ThingRow(
                statement.id, order.name, order.border, data, statement.not_before,
                statement.expires,
            )  # fmt: skip
            store.things.add(row, statement, at)
        return SignedThing(statement, data, bundle, len(ended))

    def renew_thing(self, name: str, lifetime: int) -> SignedThing:
        """State the same again, for `lifetime` from now.

        Of a router that has another key by now: the former statement ends.

        Raises:
            ThingUnknown: there is no statement about it that was not revoked.
            StoreError: its router has no valid identity.
        """
        at = self._now()
        with contextlib.closing(self.home.store()) as store:
            row = store.things.last(name)
            router = store.valid_certificate(row.border, at)
            held = row.read()
            moved = held.border != router.thumbprint and bool(store.things.ids(name, at))
        replaced = frozenset({name}) if moved else frozenset[str]()
        return self.sign_thing(ThingOrder(name, row.border, held.credential, lifetime, replaced))

    def revoke_thing(self, name: str, reason: str) -> tuple[RevocationList, int]:
        """Revoke all statements in force about a thing; returns the list, and their number.

        The node that stands for it keeps its identity, so that a new thing may take its place.

        Raises:
            ThingUnknown: there is none.
        """
        authority, at = self.unlock(), self._now()
        with authority.store.transaction():
            authority.store.things.get(name, at)
            found = authority.store.things.ids(name, at)
            return authority.revoke_all(found, reason, at), len(found)

    def things(self) -> list[thing_records.ThingState]:
        """Every statement, oldest first, with what it is now."""
        with contextlib.closing(self.home.store()) as store:
            return thing_records.states(store, self._now())

    def store_thing(self, data: bytes, bundle: bytes = b"") -> Path | None:
        """Install a statement where its router's directory is in this home; returns where.

        The identity that was signed with it as well, where the key of its node is here.

        Raises:
            HintedError: what is in that directory does not belong to the statement.
        """
        statement = peek_statement(data)
        with contextlib.closing(self.home.store()) as store:
            border = store.things.last(statement.name).border
        home, node = (NodeHome.of(self.rossec_home, name) for name in (border, statement.name))
        if not (home.path / "node.key").exists():
            return None
        if bundle and (node.path / "node.key").exists():
            node.install(bundle, self._now())
        files = ThingFiles(home)
        files.install(data)
        return files.path


def _certify(authority: SigningAuthority, order: ThingOrder, now: int) -> bytes:
    """The bundle of the identity that is asked for, if one is."""
    if not order.request:
        return b""
    asked = check_request(order.request, authority.domain)
    if asked.name != order.name:
        raise ConfigurationError(
            f"the request is of {asked.name}, not of {order.name}",
            f"on the border router: rossec border add {order.name}",
        )
    replace_key = order.name if order.name in order.replaced else None
    return authority.issue(
        order.request, now, order.identity_lifetime, replace_key=replace_key, source="border"
    )


def _key_of(authority: SigningAuthority, order: ThingOrder) -> frozenset[bytes]:
    """The thumbprint of the key that the request is for."""
    if not order.request:
        return frozenset()
    return frozenset({check_request(order.request, authority.domain).thumbprint})
