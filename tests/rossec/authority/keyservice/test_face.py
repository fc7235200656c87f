"""The network process: the join port, calls at the master, and its confinement."""

import asyncio
import socket
from collections.abc import AsyncIterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from ca.encoding import Value
from ca.enrollment.invitation import JoinClaim
from ca.enrollment.join import Named, RefusedMessage, RefuseReason, WaitingMessage, WaitReason, write
from ca.errors import JoinBusy, JoinRefused
from rossec.authority.home import AuthorityHome
from rossec.authority.invitations import invite
from rossec.authority.keyservice.front_end import FrontEnd, Handler, InnerChannel, main
from rossec.channel.edhoc.suites import OFFERED_SUITES
from rossec.clock import now
from rossec.enrollment.join import ask_name, join
from rossec.errors import KeyServiceRefused
from rossec.home import NodeHome
from rossec.host import sandbox, workers
from tests.support.commands import PASSPHRASE
from tests.support.joining import asked
from tests.support.ports import free_port
from tests.support.site import Site


class Served:
    """A service's end of the socketpair: what the face said, and what it gets."""

    def __init__(self, face: FrontEnd) -> None:
        ours, self._theirs = socket.socketpair()
        self.said: asyncio.Queue[Value] = asyncio.Queue()
        self.answer: Value = write(RefusedMessage(RefuseReason.ENDED))
        self.requests: list[Value] = []
        handlers: Mapping[str, Handler] = {
            "ready": self.say,
            "failed": self.say,
            "join": self.join,
            "name": self.join,
        }
        self.channel = InnerChannel(ours, handlers, 100_000)
        self._face = face

    async def say(self, *arguments: Value) -> Value:
        self.said.put_nowait(list(arguments))
        return None

    async def join(self, data: Value) -> Value:
        self.requests.append(data)
        return self.answer

    def give_away(self) -> int:
        """The descriptor of the face's end, for another process or thread."""
        return self._theirs.detach()

    @asynccontextmanager
    async def running(self) -> AsyncIterator["asyncio.Future[None]"]:
        face = asyncio.ensure_future(self._face.run(self._theirs))
        service = asyncio.ensure_future(self.channel.run())
        try:
            yield face
        finally:
            service.cancel()
            face.cancel()
            await asyncio.gather(service, face, return_exceptions=True)


def face_of(node: NodeHome, join_address: str, master: str = "http://127.0.0.1:1/") -> FrontEnd:
    return FrontEnd(node, join_address, master, OFFERED_SUITES)


@pytest.fixture
def home(tmp_path: Path) -> AuthorityHome:
    return AuthorityHome.create(tmp_path / "home", "home", PASSPHRASE, now())


@pytest.mark.parametrize("host", ["127.0.0.1", "*"])
async def test_nodes_are_passed_on_as_bounded_bytes(home: AuthorityHome, host: str) -> None:
    port = free_port()
    served = Served(face_of(home.node(), f"{host}:{port}"))
    code = invite(home, "/a", 1, now() + 60, f"127.0.0.1:{port}", now(), wildcard=False)
    async with served.running():
        assert await served.said.get() == [port]
        with pytest.raises(JoinRefused):
            await join(code, lambda _: asked("/a"), now)
        (request,) = served.requests
        assert isinstance(request, bytes)
        served.answer = b"nonsense"
        with pytest.raises(JoinBusy):
            await join(code, lambda _: asked("/a"), now)


async def test_claims_are_passed_on_as_bounded_bytes(home: AuthorityHome) -> None:
    port = free_port()
    served = Served(face_of(home.node(), f"127.0.0.1:{port}"))
    code = invite(home, "/*", 1, now() + 60, f"127.0.0.1:{port}", now(), wildcard=False)
    async with served.running():
        assert await served.said.get() == [port]
        served.answer = write(Named("/a"))
        assert await ask_name(code, b"<node/>", now) == "/a"
        (claim,) = served.requests
        assert isinstance(claim, bytes)
        assert JoinClaim.from_bytes(claim).metadata == b"<node/>"
        served.answer = write(RefusedMessage(RefuseReason.UNNAMED))
        with pytest.raises(JoinRefused, match="no rules"):
            await ask_name(code, b"<node/>", now)
        served.answer = write(WaitingMessage(WaitReason.LOCKED))
        with pytest.raises(JoinBusy):
            await ask_name(code, b"<node/>", now)


async def test_a_port_that_is_taken_is_reported_and_ends_it(home: AuthorityHome) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        served = Served(face_of(home.node(), where))
        async with served.running() as face:
            said = await served.said.get()
            assert isinstance(said, list)
            assert str(said[0]).startswith(f"cannot listen on {where}: ")
            await asyncio.wait_for(face, 10)


async def test_an_address_that_is_none_is_reported(home: AuthorityHome) -> None:
    served = Served(face_of(home.node(), "not an address"))
    async with served.running():
        assert "is not an address" in str(await served.said.get())


async def test_it_calls_the_master_and_returns_its_answer(site: Site) -> None:
    own = site.enroll("/ca")
    port = free_port()
    served = Served(face_of(own, f"127.0.0.1:{port}", site.environ["ROS_MASTER_URI"]))
    async with served.running():
        await served.said.get()
        assert await served.channel.call("call", "getPid", [], 10, within=20)
        with pytest.raises(KeyServiceRefused, match="http://"):
            await served.channel.call("call", "rossec.nothing", [], 10, within=20)


async def test_a_master_out_of_reach_is_a_refusal(home: AuthorityHome) -> None:
    served = Served(face_of(home.node(), f"127.0.0.1:{free_port()}"))
    async with served.running():
        await served.said.get()
        with pytest.raises(KeyServiceRefused, match=r"127\.0\.0\.1:1"):
            await served.channel.call("call", "getPid", [], 5, within=20)


async def test_it_ends_with_the_service(home: AuthorityHome) -> None:
    served = Served(face_of(home.node(), f"127.0.0.1:{free_port()}"))
    async with served.running() as face:
        await served.said.get()
    assert face.done()


async def test_the_process_is_confined_before_it_serves(
    home: AuthorityHome, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[object] = []

    def confine() -> ThreadPoolExecutor:
        done.append("processes")
        return ThreadPoolExecutor(1)

    monkeypatch.setattr(sandbox, "protect_memory", lambda: done.append("memory"))
    monkeypatch.setattr(sandbox, "read_only", lambda paths: done.append(paths[0]))
    monkeypatch.setattr(workers, "confine_processes", confine)
    node = home.node()
    served = Served(face_of(node, ""))
    arguments = [str(node.path), f"127.0.0.1:{free_port()}", "http://127.0.0.1:1/", "text"]
    service = asyncio.ensure_future(served.channel.run())
    running = asyncio.ensure_future(asyncio.to_thread(main, [str(served.give_away()), *arguments]))
    assert await served.said.get()
    assert done == ["memory", node.path, "processes"]
    service.cancel()
    await asyncio.gather(service, return_exceptions=True)
    async with asyncio.timeout(30):
        await running
