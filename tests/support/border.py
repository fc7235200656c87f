"""A site with a border router, in one process: statements, identities and grants of its things."""

import asyncio
import contextlib
import dataclasses
import secrets
from collections.abc import AsyncIterator
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.keys.signing import thumbprint
from ca.store.signed_statements import ThingRow
from ca.things import Credential, ThingSecret, ThingStatement, sign_statement
from grants.model import Right
from rossec.border.border_router import BorderRouter
from rossec.border.handshakes import StaticKey
from rossec.home import NodeHome
from rossec.saved_statements import ThingFiles
from tests.support.constrained import SecretThing, Thing
from tests.support.site import DAY, Site

BORDER: Final = "/border"
LAMP: Final = "/things/lamp"
TEMPERATURE: Final = (
    '</t>;rt="ros.pub";if="std_msgs/Float32";title="~temperature";ct=60;obs,'
    '</l>;rt="ros.sub";if="std_msgs/Bool";title="~light";ct=60,'
    '</s>;rt="ros.srv";if="std_srvs/SetBool";title="~switch";ct=60'
)


class BorderSite:
    """A site, and what belongs to its border router."""

    def __init__(self, site: Site, name: str = BORDER) -> None:
        self.site, self.name = site, name
        self.home: NodeHome = site.enroll(name)
        self.files = ThingFiles(self.home)
        self.key = StaticKey(ec.generate_private_key(ec.SECP256R1()))
        self.router: BorderRouter

    def state(self, name: str, credential: Credential, **changes: Any) -> ThingStatement:
        """The authority states what a thing is, and the router takes it; its node is enrolled."""
        site, now = self.site, self.site.now()
        site.enroll(name)
        border = thumbprint(self.home.signer().public_key)
        statement = dataclasses.replace(
            ThingStatement(
                site.anchor.domain, name, credential, border, now - 5, now + DAY, secrets.token_bytes(16)
            ),
            **changes,
        )
        authority = site.authority
        data = sign_statement(authority.signer, statement)
        row = ThingRow(statement.id, name, self.name, data, statement.not_before, statement.expires)
        authority.store.things.add(row, statement, now)
        if statement.border == border:
            self.files.install(data)
        return statement

    def thing(self, name: str = LAMP, links: str = TEMPERATURE, kid: bytes = b"\x2c") -> Thing:
        """A thing with a key, which is stated."""
        thing = Thing(self.address, self.key.credential, links, kid)
        self.state(name, thing.credential)
        return thing

    def secret_thing(self, name: str = LAMP, links: str = TEMPERATURE, kid: bytes = b"\x07") -> SecretThing:
        """A thing with a secret, which is stated."""
        secret = self.files.create_secret(name)
        thing = SecretThing(self.address, secret, links, kid)
        self.state(name, ThingSecret.of(secret, kid))
        return thing

    def allow(self, name: str = LAMP, right: Right = Right.PUBLISH, what: str = "") -> bytes:
        """A grant for a thing's node, of names below its own by default."""
        return self.site.grant(name, right, what or f"{name}/**")

    def roster_statement(self, name: str) -> ThingStatement:
        """The statement that is installed."""
        return self.files.load().statements[name]

    async def revoke(self, entry: bytes) -> None:
        """Revoke a statement or a key; the master tells all."""
        self.site.authority.revoke(entry, "test", self.site.now())
        data = self.site.authority.store.newest_list()
        call = self.router.node._membership.session.call
        await call("rossec.updateRevocations", data)
        async with asyncio.timeout(10):  # the master tells the router as every node
            while entry not in self.router.node.revocations.entries:  # noqa: ASYNC110 - no event
                await asyncio.sleep(0.01)

    @property
    def address(self) -> tuple[str, int]:
        """Where things reach the router."""
        return self.router.server.address

    @contextlib.asynccontextmanager
    async def running(self, port: int = 0) -> AsyncIterator["BorderSite"]:
        """With the router, on a port of `::1`."""
        self.router = BorderRouter(self.name, self.key, self.site.environ, "::1", port)
        try:
            await self.router.start()
            yield self
        finally:
            await self.router.close()
