"""What an authority does for its users, by what it is about: identities, grants, policy, domains, things.

The command line calls this, and other interfaces can. Each method returns what was done, or raises a refusal.
Everything signed is recorded before it is returned.
"""

import secrets
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from string import hexdigits
from typing import Final, NamedTuple

from ca.certificates import Identity
from ca.errors import ThingRefused
from ca.revocation.lists import RevocationList
from ca.store.signed_statements import ThingRow
from ca.store.values import INTERMEDIATE, RequestRow, RequestState
from ca.svid import IdentityRequest, check_request
from ca.things import Credential, ThingStatement, peek_statement, sign_statement
from rossec.authority import domain_operations, grant_operations, renewals, signing
from rossec.authority.session import AuthoritySession
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.saved_statements import ThingFiles

SERIAL: Final = 16


@dataclass(eq=False, repr=False)
class AuthorityService(AuthoritySession):
    def __post_init__(self) -> None:
        self.identities = Identities(self)
        self.grants = grant_operations.Grants(self)
        self.policy = grant_operations.PolicyWork(self, self.grants)
        self.domains = domain_operations.Domains(self)
        self.things = Things(self)


class Identities:
    def __init__(self, session: AuthoritySession) -> None:
        self._session = session

    def add_request(self, request: IdentityRequest, csr: bytes, source: str) -> RequestRow:
        at = self._session.now()
        with self._session.record() as store:
            if store.identities.issued_for(request.digest) is None:
                return store.requests.add(request, csr, source, at)
        return RequestRow(
            request.digest, request.name, request.thumbprint, csr, source, at, RequestState.ISSUED, "", at
        )

    def request(self, beginning: str) -> RequestRow:
        """The one request for an identity whose id begins so, every digit of it."""
        if not set(beginning) <= set(hexdigits):
            raise ConfigurationError(f"{beginning!a} is not a request id", "see: rossec ca requests")
        with self._session.record() as store:
            return store.requests.begun(beginning)

    def deny_request(self, row: RequestRow, reason: str) -> None:
        with self._session.record() as store:
            store.requests.deny(row.digest, self._session.now(), reason)

    def issue(
        self, csr: bytes, lifetime: int, *, replace_key: str | None, wildcard: bool, source: str
    ) -> bytes:
        authority, at = self._session.unlock(), self._session.now()
        return authority.issue(csr, at, lifetime, replace_key=replace_key, wildcard=wildcard, source=source)

    def renew_own_node(self) -> int:
        return renewals.renew_own_node(self._session.unlock(), self._session.now())

    def renew(self, name: str, lifetime: int, *, expired: bool = False) -> bytes:
        if name.startswith(INTERMEDIATE):
            raise ConfigurationError(
                f"{name} is an intermediate", "sign its request again: `rossec ca intermediate sign`"
            )
        authority, at = self._session.unlock(), self._session.now()
        return renewals.renew_by_name(authority, name, at, lifetime, expired=expired)

    def import_bundle(self, bundle: bytes, replaced: Collection[str] = ()) -> tuple[Identity, bool]:
        return renewals.import_identity(self._session.unlock(), bundle, self._session.now(), replaced)

    def sign_intermediate(self, csr: bytes, *, may_enroll: bool, lifetime: int) -> tuple[str, bytes]:
        authority, at = self._session.unlock(), self._session.now()
        return renewals.sign_intermediate(authority, csr, at, may_enroll=may_enroll, lifetime=lifetime)

    def revoke(self, name: str, reason: str) -> tuple[RevocationList, int]:
        return self._session.unlock().revoke_identity(name, reason, self._session.now())

    def intermediates(self) -> list[str]:
        with self._session.record() as store:
            rows = store.identities.all_valid(self._session.now())
        return sorted({row.name for row in rows if row.name.startswith(INTERMEDIATE)})


@dataclass(frozen=True)
class ThingOrder:
    """`name`: of the thing, and of the node that stands for it. `border`: the name of the border router
    that serves it. `credential`: how the thing proves who it is. `lifetime`: of the statement, seconds.
    `replaced`: names of things whose statements end by this one. `request`: for the identity of the node
    (DER), if it is to be signed as well. `identity_lifetime`: of that identity, seconds.
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


class Things:
    """Constrained things.

    A statement, the identity that goes with it, and the end of what it replaces are one transaction:
    signed and recorded together, or not at all. A statement reaches its border router as a file, or at
    once where that router's directory is in this ROSSEC_HOME.
    """

    def __init__(self, session: AuthoritySession) -> None:
        self._session = session

    def sign(self, order: ThingOrder) -> SignedThing:
        authority, at = self._session.unlock(), self._session.now()
        if not authority.authority.is_root:
            raise ConfigurationError("an intermediate cannot say what a thing is", "at the root")
        if order.name == order.border:
            raise ThingRefused(
                f"{order.name} is the border router, and no thing of its own",
                "a thing has a name of its own: /things/lamp",
            )
        store, bundle, own_key = authority.store, b"", frozenset[bytes]()
        with store.transaction():
            router = store.valid_certificate(order.border, at)
            store.identities.check_not_revoked(order.name, order.credential.thumbprint)
            about = authority.domain, order.name, order.credential, router.thumbprint
            serial = secrets.token_bytes(SERIAL)
            statement = ThingStatement(*about, at - signing.SKEW, at + order.lifetime, serial)
            # 1. what it replaces ends: its statements, and the keys of its node
            ended = signing.replaced_by(store, order.name, router.thumbprint, order.replaced, at)
            # 2. the identity of the node, which is not ended by its own statement
            if order.request:
                asked = check_request(order.request, authority.domain)
                if asked.name != order.name:
                    raise ConfigurationError(
                        f"the request is of {asked.name}, not of {order.name}",
                        f"on the border router: rossec border add {order.name}",
                    )
                key, lifetime = order.name if order.name in order.replaced else None, order.identity_lifetime
                bundle = authority.issue(order.request, at, lifetime, replace_key=key, source="border")
                own_key = frozenset({asked.thumbprint})
            # 3. the list without what was replaced
            ended -= own_key
            if ended:
                authority.revoke_all(ended, f"replaced by {order.name}", at)
            authority.refresh_list(at)
            # 4. the statement
            data = sign_statement(authority.signer, statement)
            begin, end = statement.not_before, statement.expires
            row = ThingRow(statement.id, order.name, order.border, data, begin, end)
            store.things.add(row, statement, at)
        return SignedThing(statement, data, bundle, len(ended))

    def renew(self, name: str, lifetime: int) -> SignedThing:
        # Of a router that has another key by now: the former statement ends.
        at = self._session.now()
        with self._session.record() as store:
            row = store.things.last(name)
            router = store.valid_certificate(row.border, at)
            held = row.read()
            moved = held.border != router.thumbprint and bool(store.things.ids(name, at))
        replaced = frozenset({name}) if moved else frozenset[str]()
        return self.sign(ThingOrder(name, row.border, held.credential, lifetime, replaced))

    def revoke(self, name: str, reason: str) -> tuple[RevocationList, int]:
        # The node that stands for it keeps its identity, so that a new thing may take its place.
        authority, at = self._session.unlock(), self._session.now()
        with authority.store.transaction():
            authority.store.things.get(name, at)
            found = authority.store.things.ids(name, at)
            return authority.revoke_all(found, reason, at), len(found)

    def states(self) -> list[signing.ThingState]:
        with self._session.record() as store:
            return signing.states(store, self._session.now())

    def store(self, data: bytes, bundle: bytes = b"") -> Path | None:
        # The identity that was signed with it as well, where the key of its node is here.
        statement = peek_statement(data)
        with self._session.record() as store:
            border = store.things.last(statement.name).border
        home, node = (NodeHome.of(self._session.rossec_home, name) for name in (border, statement.name))
        if not (home.path / "node.key").exists():
            return None
        if bundle and (node.path / "node.key").exists():
            node.install(bundle, self._session.now())
        files = ThingFiles(home)
        files.install(data)
        return files.path
