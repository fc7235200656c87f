"""Invitations, nodes that join by them, and the authority's port, in memory or on loopback."""

import asyncio
import contextlib
import itertools
import threading
import time
from collections.abc import AsyncIterator, Callable
from hashlib import sha256
from pathlib import Path
from typing import Self

from ca.enrollment.invitation import InvitationCode, JoinClaim, JoinRequest
from ca.enrollment.join import (
    AuthorityJoin,
    Issued,
    JoinAnswer,
    LiveIdentity,
    NameAnswer,
    NodeJoin,
    RefusedMessage,
    RefuseReason,
)
from ca.keys.signing import KeySigner
from ca.names import AUTHORITY
from ca.store.identities import InvitationRow
from ca.svid import build_request
from rossec.authority.home import AuthorityHome
from rossec.authority.invitations import allowed_pattern, join
from rossec.authority.keyservice.network import JoinNames
from rossec.enrollment.join import JoinServer
from tests.support.pki import NOW, new_signer
from tests.support.site import Site

HOUR = 3600
PATTERN = "/fleet/*"
_numbers = itertools.count(1)


def fresh(size: int = 16) -> bytes:
    """Bytes that are not repeated."""
    return next(_numbers).to_bytes(size)


class JoinSite:
    """A site whose authority has its own node, and invitations."""

    def __init__(self, root: Path, clock: Callable[[], float] = lambda: NOW) -> None:
        self.site = Site(root, clock=clock)
        self.authority = self.site.authority
        self.store = self.authority.store
        self.root = self.site.anchor.certificate
        self.own = self.site.enroll(AUTHORITY)
        self.address = "127.0.0.1:9"

    @property
    def now(self) -> int:
        return self.site.now()

    def invite(
        self, pattern: str = PATTERN, uses: int = 1, *, lasts: int = HOUR, wildcard: bool = False
    ) -> InvitationCode:
        """A recorded invitation."""
        expires = self.now + lasts
        code = InvitationCode(self.site_hash(), fresh(), expires, self.address, pattern, wildcard=wildcard)
        self.store.invitations.add(
            InvitationRow(code.id, code.key, pattern, uses, wildcard, expires, self.now)
        )
        return code

    def site_hash(self) -> bytes:
        return sha256(self.root).digest()

    def identity(self) -> LiveIdentity:
        """That of `/ca`."""
        own = self.own.credentials()
        return LiveIdentity(own.signer, own.chain, self.root)

    def request(self, code: InvitationCode, csr: bytes, identity: LiveIdentity | None = None) -> JoinRequest:
        """The request of a node that joins by `code`, as the authority's key gets it."""
        node = NodeJoin(code, fresh())
        face = AuthorityJoin(identity or self.identity(), fresh())
        welcome = face.receive(node.hello())
        assert welcome is not None
        node.receive(welcome, self.now)
        assert face.receive(node.join(csr)) is None
        return face.request

    def join(
        self,
        code: InvitationCode,
        name: str = "/fleet/robot07",
        signer: KeySigner | None = None,
        now: int | None = None,
    ) -> JoinAnswer:
        """The answer to a node with a key of its own."""
        csr = asked(name, signer, wildcard=code.wildcard)
        return join(self.authority, self.request(code, csr), self.now if now is None else now)

    @contextlib.asynccontextmanager
    async def serving(self, server: JoinServer | None = None) -> AsyncIterator[JoinServer]:
        """With its port, on loopback; invitations made in here name it."""
        serving = JoinServer(self.identity, self.admit) if server is None else server
        await serving.listen("127.0.0.1", 0)
        self.address = f"127.0.0.1:{serving.port}"
        try:
            yield serving
        finally:
            await serving.close()

    async def admit(self, request: JoinRequest) -> JoinAnswer:
        return join(self.authority, JoinRequest.from_bytes(request.to_bytes()), self.now)


class JoinPort:
    """The join port of an authority's directory, in a thread: its key is unlocked in there.

    `answers` are given first, before the authority decides; `requests` are those that came. Where
    there are `rules`, claims are named by them.
    """

    def __init__(self, root: Path, passphrase: str, rules: bytes | None = None) -> None:
        self._rules = rules
        self.answers: list[JoinAnswer] = []
        self.requests: list[JoinRequest] = []
        self.port = 0
        self._home, self._passphrase = AuthorityHome.at(root), passphrase
        self._listening, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))

    def __enter__(self) -> Self:
        self._thread.start()
        assert self._listening.wait(20)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    async def _run(self) -> None:
        authority = self._home.unlock(self._passphrase)
        own = self._home.node().credentials()
        identity = LiveIdentity(own.signer, own.chain, self._home.anchor().certificate)

        async def admit(request: JoinRequest) -> JoinAnswer:
            self.requests.append(request)
            if self.answers:
                return self.answers.pop(0)
            return join(authority, request, int(time.time()))

        async with JoinNames(self._rules) as names:

            async def name(claim: JoinClaim) -> NameAnswer:
                pattern = allowed_pattern(authority.store, claim, int(time.time()))
                if isinstance(pattern, RefusedMessage):
                    return pattern
                return await names.answer(claim.metadata, pattern)

            server = JoinServer(lambda: identity, admit, name=name)
            await server.listen("127.0.0.1", 0)
            self.port = server.port
            self._listening.set()
            await asyncio.get_running_loop().run_in_executor(None, self._stop.wait)
            await server.close()
        authority.store.close()


def asked(name: str, signer: KeySigner | None = None, *, wildcard: bool = False) -> bytes:
    """A request (CSR) for `name`."""
    return build_request(signer or new_signer(), "home", name, wildcard=wildcard)


def issued(answer: JoinAnswer) -> bytes:
    """The certificate in an answer."""
    assert isinstance(answer, Issued), answer
    return answer.chain[0]


def refusal(answer: JoinAnswer) -> RefuseReason:
    """The reason in an answer."""
    assert isinstance(answer, RefusedMessage), answer
    return answer.reason
