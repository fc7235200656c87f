"""Callers of the master's API with exactly the grants given."""

import contextlib
from collections.abc import AsyncIterator, Mapping
from types import MappingProxyType
from typing import Any, Final

from grants.model import Right
from rossec.demo.intruder import UnverifiedPeer
from rossec.net.aio import SecureStream, WireProtocol, serve
from rossec.net.rpc.calls import RpcClient, serve_calls
from tests.support.attacker import HOST, credentials, dial
from tests.support.contexts import unlimited
from tests.support.site import Site

_NONE: Final[Mapping[str, Right]] = MappingProxyType({})


class Caller:
    """A control connection under its certified name; returns answers unchanged."""

    def __init__(self, site: Site, name: str, client: RpcClient) -> None:
        self.site = site
        self.name = name
        self.client = client
        self.uri = ""
        self.told: list[tuple[object, ...]] = []

    async def __call__(self, method: str, *params: object) -> Any:
        """The whole answer, `[code, status, value]`."""
        return await self.client.call(method, self.name, *params)

    async def lie(self, method: str, *params: object) -> Any:
        """The same call with another caller_id."""
        return await self.client.call(method, *params)

    async def refused(self, method: str, *params: object) -> str:
        """The status text of a call that must be refused, with its default value."""
        return refusal(await self(method, *params))

    async def dispatch(self, method: str, params: tuple[object, ...], peer: UnverifiedPeer) -> object:
        self.told.append((method, *params[1:]))
        return [1, "", 0]


def refusal(answer: Any) -> str:
    """Assert that the answer is a refusal by rossec; its text."""
    code, status, value = answer
    assert code == -1, answer
    assert status.startswith("rossec: "), answer
    assert not value or value == [[], [], []]
    return str(status)


@contextlib.asynccontextmanager
async def caller(site: Site, name: str, rights: Mapping[str, Right] = _NONE) -> AsyncIterator[Caller]:
    """A caller with these rights by pattern and its earlier ones; its slave API answers."""
    assert site.master is not None
    for pattern, right in rights.items():
        site.grant(name, right, pattern)
    found = Caller(site, name, RpcClient(await dial(site.master.uri, credentials(site, name))))

    async def slave(stream: SecureStream[Any]) -> None:
        await serve_calls(stream, found.dispatch)

    own = site.enroll(name)
    async with serve(
        slave, HOST, 0, unlimited(own.credentials(), site.anchor.verify), WireProtocol.HTTP
    ) as server:
        found.uri = f"http://{HOST}:{server.port}/"
        assert (await found("rossec.presentGrants", own.grants()))[0] == 1
        try:
            yield found
        finally:
            await found.client.close()
