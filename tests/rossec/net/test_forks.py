"""Parent and child never seal under the same nonce: the child has nothing to seal with."""

import asyncio
import os
import socket
from collections.abc import Callable, Iterator

import pytest

from rossec.errors import ChannelClosed
from rossec.net.aio import connect, serve
from rossec.net.context import forget_in_children
from tests.support.contexts import context
from tests.support.listener import SecureListener
from tests.support.secure_sockets import dial, make_listener, pair
from tests.support.wire import ALICE, BOB, FakeIdentity


@pytest.fixture
def listener() -> Iterator[SecureListener[FakeIdentity]]:
    with make_listener() as made:
        yield made


def in_child(work: Callable[[], object]) -> str:
    """What came of `work` in a forked process."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            said = repr(work())
        except BaseException as error:  # noqa: BLE001 - reported to the parent
            said = f"{type(error).__name__}: {error}"
        os.write(writing, said.encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as report:
        said = report.read()
    os.waitpid(child, 0)
    return said


def test_a_child_cannot_use_its_parents_connection(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener)
    with left, right:
        assert left.try_send(b"0")  # however long the children take now
        for use in (
            lambda: left.sendall(b"child"),
            lambda: left.try_send(b"child"),
            lambda: left.sendall(bytes(500_000)),
        ):
            assert in_child(use).startswith("ChannelClosed: a forked process cannot use its"), use
        assert in_child(lambda: left.recv(1)) == "b''"
        assert in_child(left.close) == "None"
        left.sendall(b"1")
        assert right.recv(1) + right.recv(1) == b"01"


def test_a_child_that_could_not_forget_does_not_run() -> None:
    class Stubborn:
        def abandon(self) -> None:
            raise RuntimeError("no")

    stubborn = Stubborn()
    forget_in_children(stubborn)
    assert in_child(lambda: "ran") == ""
    del stubborn
    assert in_child(lambda: "ran") == "'ran'"


def test_a_lock_held_at_the_fork_stops_no_child(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener)
    with left, right:
        with left._core_lock, left._reading, left._writing:
            assert in_child(lambda: left.sendall(b"x")).startswith("ChannelClosed")
            assert in_child(left.shutdown) == "None"
        left.sendall(b"x")
        assert right.recv(1) == b"x"


def test_a_count_locked_at_the_fork_stops_no_child(listener: SecureListener[FakeIdentity]) -> None:
    """The parent counts half-open connections; a thread may hold that lock at the fork."""
    with socket.create_connection(listener.getsockname()):
        stranger, _ = listener.accept()
        with stranger:
            with listener._context.half_open._lock:
                assert in_child(lambda: stranger.recv(1)) == "b''"
            assert len(listener._context.half_open) == 1
        assert len(listener._context.half_open) == 0


def test_a_child_may_connect_for_itself(listener: SecureListener[FakeIdentity]) -> None:
    def work() -> bytes:
        with dial(listener, context(ALICE)) as own:
            own.sendall(b"child")
            return own.recv(10)

    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(writing, work())
        os._exit(0)
    accepted, _ = listener.accept()
    with accepted:
        assert accepted.recv(10) == b"child"
        accepted.sendall(b"welcome")
        assert os.read(reading, 10) == b"welcome"
    os.waitpid(child, 0)
    for end in (reading, writing):
        os.close(end)


async def test_a_child_cannot_use_streams_of_the_parents_loop() -> None:
    heard: asyncio.Queue[bytes] = asyncio.Queue()

    async def handler(stream: object) -> None:
        while True:
            await heard.put(await stream.receive())  # type: ignore[attr-defined]

    server = serve(handler, "127.0.0.1", 0, context(BOB))
    stream = await connect("127.0.0.1", server.port, context(ALICE))
    try:
        await stream.send(b"one")
        assert in_child(lambda: stream.write_nowait(b"child")).startswith(ChannelClosed.__name__)
        await stream.send(b"two")
        async with asyncio.timeout(10):
            assert [await heard.get(), await heard.get()] == [b"one", b"two"]
    finally:
        await stream.close()
        await server.close()
