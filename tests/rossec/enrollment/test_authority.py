import asyncio
import socket
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

import pytest

from ca.enrollment import qr
from ca.enrollment.messages import Abort, Delivery, Reason, frame, write
from ca.enrollment.sides import AuthorityEnrollment, AuthorityState
from ca.errors import EnrollmentExpired, EnrollmentOver, RequestSwapped
from rossec.enrollment import enroll
from rossec.errors import NotDelivered, PeerUnreachable
from tests.support.enrolling import Robot, WaitingRobot, clock, fresh
from tests.support.pki import Site

SITE = Site.create(now=clock())


async def enrolled(robot: WaitingRobot, core: AuthorityEnrollment) -> list[str]:
    shown: list[str] = []
    await enroll.fetch(core, robot._host, robot.port, clock)
    await enroll.deliver(core, offer(core), robot._host, robot.port, clock, shown.append)
    return shown


def offer(core: AuthorityEnrollment) -> bytes:
    core.approve(clock())
    leaf = SITE.authority.issue(core.csr, now=clock(), serial=7)
    return core.offer([leaf], SITE.root, fresh(), clock())


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
@pytest.mark.parametrize("label", [False, True])
async def test_an_enrollment(host: str, label: bool) -> None:
    with WaitingRobot(Robot(), host=host, label=label) as robot:
        core = AuthorityEnrollment(qr.parse(robot.code), "home")
        shown = await enrolled(robot, core)
    assert core.state is AuthorityState.ENROLLED
    assert [pending.digits for pending in robot.trusted] == shown == [core.digits]


async def test_no_node_at_the_address() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    core = AuthorityEnrollment(qr.parse(Robot().enrollment().code("x")), "home")
    with pytest.raises(PeerUnreachable, match=f"no node waits to be enrolled at 127.0.0.1:{port}"):
        await enroll.fetch(core, "127.0.0.1", port, clock)


Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Coroutine[Any, Any, None]]


@asynccontextmanager
async def server(handler: Handler) -> AsyncIterator[int]:
    found = await asyncio.start_server(handler, "127.0.0.1", 0)
    async with found:
        yield found.sockets[0].getsockname()[1]


async def test_another_node_at_the_address() -> None:
    robot, swapped = Robot(), Robot()

    async def impostor(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(frame(write(Delivery(swapped.csr))))
        writer.close()

    core = AuthorityEnrollment(qr.parse(robot.enrollment(now=clock()).code("x")), "home")
    async with server(impostor) as port:
        with pytest.raises(RequestSwapped):
            await enroll.fetch(core, "127.0.0.1", port, clock)


async def test_the_person_walks_away() -> None:
    with WaitingRobot(Robot(), person=lambda _: "wrong") as robot:
        core = AuthorityEnrollment(qr.parse(robot.code), "home")
        with pytest.raises(EnrollmentOver, match="the node has ended the enrollment"):
            await enrolled(robot, core)


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(enroll, "RETRY_DELAY", 0.0)


@pytest.mark.usefixtures("hurried")
async def test_a_broken_connection_is_made_again() -> None:
    """The same offer, to the letter; the answer comes at the third call, the end at the fifth."""
    robot = Robot()
    node = robot.enrollment(now=clock())
    core = AuthorityEnrollment(qr.parse(node.code("x")), "home")
    core.receive(node.receive(core.fetch(), clock())[0], clock())
    made = offer(core)
    answers = node.receive(made, clock())
    node.confirm(node.pending.digits, clock())
    done = node.activated()
    scripts = [[], [], answers, [], answers + done]
    heard: list[bytes] = []

    async def forgetful(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        heard.append(await reader.readexactly(len(frame(made))))
        for message in scripts.pop(0):
            writer.write(frame(message))
        writer.close()

    shown: list[str] = []
    async with server(forgetful) as port:
        await enroll.deliver(core, made, "127.0.0.1", port, clock, shown.append)
    assert heard == [frame(made)] * 5
    assert shown == [node.pending.digits]


@pytest.mark.usefixtures("hurried")
async def test_a_node_that_does_not_come_back() -> None:
    calls = 0

    async def gone(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal calls
        calls += 1
        writer.close()

    core = AuthorityEnrollment(qr.parse(Robot().enrollment(now=clock()).code("x")), "home")
    core._code = qr.parse(qr.label_code(CSR))
    core.receive(write(Delivery(CSR)), clock())
    made = offer(core)
    async with server(gone) as port:
        with pytest.raises(NotDelivered, match="closed the connection before") as caught:
            await enroll.deliver(core, made, "127.0.0.1", port, clock, lambda _: None)
    assert calls == 5
    assert "rossec node show /robot1/camera" in caught.value.hint
    with pytest.raises(EnrollmentExpired):
        await enroll.deliver(core, made, "127.0.0.1", port, lambda: clock() + 1000, lambda _: None)


CSR = Robot().csr


async def test_a_node_that_refuses() -> None:
    async def refusing(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(frame(write(Abort(Reason.REFUSED))))
        writer.close()

    core = AuthorityEnrollment(qr.parse(qr.label_code(CSR)), "home")
    core.receive(write(Delivery(CSR)), clock())
    made = offer(core)
    async with server(refusing) as port:
        with pytest.raises(EnrollmentOver, match="refused the offer"):
            await enroll.deliver(core, made, "127.0.0.1", port, clock, lambda _: None)


async def test_a_connection_that_cannot_become_a_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(**_: object) -> None:
        raise OSError("no transport")

    async def silent(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.close()

    core = AuthorityEnrollment(qr.parse(qr.label_code(CSR)), "home")
    async with server(silent) as port:
        monkeypatch.setattr(asyncio, "open_connection", broken)
        with pytest.raises(PeerUnreachable):
            await enroll.fetch(core, "127.0.0.1", port, clock)
