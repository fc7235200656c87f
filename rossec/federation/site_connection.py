"""A connection with the master of a site: dialled, and checked who answers. A shell."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import shown, split_alias
from ca.errors import CAError, RevocationsStale
from rossec.errors import SiteRefused
from rossec.federation.own import OwnMaster
from rossec.federation.settings import SiteSettings
from rossec.federation.states import SILENCE
from rossec.federation.via import SiteDoors
from rossec.net.aio import SecureStream, WireProtocol, connect
from rossec.net.rpc.client import RpcClient

_DIAL: Final = 5.0
_DIAL_VIA: Final = 15.0  # the relay may have to dial its peer first


class SiteConnections:
    """Connects with one site.

    Args:
        doors: of the site, if it is reached by a relay.
    """

    def __init__(self, settings: SiteSettings, own: OwnMaster, doors: SiteDoors | None) -> None:
        self._settings = settings
        self._own = own
        self._doors = doors

    @contextlib.asynccontextmanager
    async def open(self) -> AsyncIterator[tuple[RpcClient, Identity]]:
        """A connection with the site, whose identity is checked.

        Raises:
            SiteRefused: another identity, or one that is revoked.
            RossecError, OSError, TimeoutError: no connection.
        """
        async with asyncio.timeout(_DIAL if self._doors is None else _DIAL_VIA):
            doors, settings = self._doors, self._settings
            address = settings.address if doors is None else await doors.address()
            stream = await connect(*address, self._own.context, WireProtocol.HTTP)
        try:
            self._check(stream)
            yield RpcClient(stream, deadline=SILENCE), stream.peer
        finally:
            await stream.close()

    def check_trust(self, peer: Identity) -> None:
        """Return if the lists of now let this master follow `peer`.

        Raises:
            SiteRefused: it is revoked, or the trust in its domain has ended.
        """
        try:
            self._own.state.trust.caller(peer, self._own.state.now())
        except RevocationsStale:  # of its domain: it is asked for them
            return
        except CAError as error:
            raise SiteRefused(f"{shown(peer.name)}: {error}", error.hint) from error

    def _check(self, stream: SecureStream[Identity]) -> None:
        """The peer is the master that is followed, and not revoked."""
        peer, expected = stream.peer, self._settings
        alias = split_alias(peer.name) if peer.is_foreign else None
        label, name = ("", peer.name) if alias is None else alias
        if (label, name) != (expected.domain, expected.master):
            stream.abort("not the master that is followed")
            raise SiteRefused(
                f"{shown(peer.name)} answers {expected.place}, not {expected.master}"
                + (f" of {expected.domain}" if expected.domain else ""),
                "check the address: rossec federation list",
            )
        self.check_trust(peer)
