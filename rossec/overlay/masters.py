"""The masters of a relay's site: its own, and those of the domain that follow each other in a mesh.

A shell. The own master names the others; each says which doors it wants, and where targets that are
registered at it are.
"""

import asyncio
from collections.abc import Mapping
from functools import partial

from ca.certificates import Identity
from ca.errors import HintedError
from rossec.errors import RelayRefused
from rossec.master.state.doors import MASTER
from rossec.net.aio import SecureStream, WireProtocol, connect
from rossec.net.aio.tasks import TaskSet
from rossec.overlay.master_link import DoorTable, MasterLink
from rossec.overlay.member import RelayMember
from rossec.ros.settings import parse_uri


class OwnMasters:
    """The links of a relay to masters of its own domain.

    Args:
        member: the relay's identity.
        instance: random, of this run of the relay.
        doors: those of the relay.
    """

    def __init__(self, member: RelayMember, instance: str, doors: DoorTable) -> None:
        self._member = member
        self._instance = instance
        self._doors = doors
        self._links: dict[str, MasterLink] = {}
        self._runs: dict[str, asyncio.Task[None]] = {}
        self._uris: dict[str, str] = {}
        self._lists_due = asyncio.Event()
        self._tasks = TaskSet(self._crashed)
        self._failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def start(self) -> None:
        """Begin with the own master."""
        dial = self._member.dial_master
        own = self._member.master
        self._tasks.spawn(self._refresh(), "asking for lists")
        self._begin(MasterLink(
            own, self._member.name, self._instance, dial, self._doors, self._answered
        ))  # fmt: skip

    async def wait_failed(self) -> None:
        """Wait until a part crashes, and raise that."""
        await asyncio.shield(self._failed)

    async def close(self) -> None:
        """End every connection with a master."""
        await self._tasks.close()
        for link in self._links.values():
            await link.close()
        self._failed.cancel()

    async def target(self, domain: str, kind: str, name: str) -> tuple[str, int]:
        """Host and port of a target, of the master at which it is; see `MasterLink.target`.

        Raises:
            HintedError: no master has it, or shows it to that domain.
        """
        if kind == MASTER:
            links = [self._links[name]] if name in self._links else []
        else:
            links = list(self._links.values())
        refusal: HintedError = RelayRefused(f"no {kind} {name} is shown there")
        for link in links:
            try:
                return await link.target(domain, kind, name)
            except HintedError as error:
                refusal = error
            except (OSError, TimeoutError) as error:
                refusal = RelayRefused(f"{link.name} does not answer: {error}")
        raise refusal

    def status(self) -> dict[str, str]:
        """Why each master is not polled, by its name; empty: it is."""
        return {name: link.error for name, link in self._links.items()}

    def _begin(self, link: MasterLink) -> None:
        self._links[link.name] = link
        self._runs[link.name] = self._tasks.spawn(link.run(), f"doors of {link.name}")

    async def _refresh(self) -> None:
        """Ask for lists after each answer; while that takes, answers count as one."""
        while True:
            await self._lists_due.wait()
            self._lists_due.clear()
            await self._member.refresh()

    def _crashed(self, error: BaseException) -> None:
        if not self._failed.done():
            self._failed.set_exception(error)

    def _answered(self, masters: Mapping[str, str]) -> None:
        """The own master has answered: lists may be new, and the mesh another one."""
        self._lists_due.set()
        own = self._member.master
        named = {name: uri for name, uri in masters.items() if name != own}
        for name in [name for name, uri in self._uris.items() if named.get(name) != uri]:
            del self._uris[name]
            self._runs.pop(name).cancel()
            self._tasks.spawn(self._links.pop(name).close(), f"leaving {name}")
        for name, uri in named.items():
            if name not in self._uris:
                self._uris[name] = uri
                self._begin(self._link_to(name, uri))

    def _link_to(self, name: str, uri: str) -> MasterLink:
        dial = partial(self._dial, uri)
        return MasterLink(name, self._member.name, self._instance, dial, self._doors, _ignore)

    async def _dial(self, uri: str) -> SecureStream[Identity]:
        address = parse_uri(uri, "the master's URI")
        stream = await connect(*address, self._member.context, WireProtocol.HTTP)
        try:
            self._member.check_peer(stream.peer)
        except BaseException:
            stream.abort("the master's identity is revoked or cannot be checked")
            raise
        return stream


def _ignore(_masters: Mapping[str, str]) -> None:
    """Only the own master says which others there are."""
