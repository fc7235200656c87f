"""The socket by itself, between two ends of a socket pair."""

import asyncio
import fcntl
import socket
import struct

import pytest

from rossec.net.aio.transport import Transport


class Recorder:
    def __init__(self) -> None:
        self.buffer = bytearray(1 << 20)
        self.got = bytearray()
        self.events: list[str] = []
        self.changed = asyncio.Event()

    def _note(self, event: str) -> None:
        self.events.append(event)
        self.changed.set()

    def get_buffer(self) -> memoryview:
        return memoryview(self.buffer)

    def buffer_updated(self, count: int) -> None:
        self.got += self.buffer[:count]

    def eof_received(self) -> bool | None:
        self._note("eof")
        return None

    def resume_writing(self) -> None:
        self._note("drained")

    def connection_lost(self) -> None:
        self._note("lost")


def pair(recorder: Recorder | None = None) -> tuple[Transport, Recorder, socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        other = socket.create_connection(server.getsockname())
        mine, _ = server.accept()
    recorder = recorder or Recorder()
    transport = Transport(mine, recorder)
    transport.resume_reading()
    return transport, recorder, other


async def until(recorder: Recorder, event: str) -> None:
    async with asyncio.timeout(30):
        while event not in recorder.events:
            recorder.changed.clear()
            await recorder.changed.wait()


async def swallow(other: socket.socket, count: int) -> bytes:
    loop, got = asyncio.get_running_loop(), bytearray()
    other.setblocking(False)
    while len(got) < count:
        got += await loop.sock_recv(other, 1 << 20)
    return bytes(got)


async def test_what_the_kernel_does_not_take_is_sent_later() -> None:
    transport, recorder, other = pair()
    data = bytes(range(256)) * 40_000
    transport.write(data)
    transport.write(b"tail")
    backlog = transport.backlog
    assert backlog > 64 * 1024
    transport.write_eof()
    assert await swallow(other, len(data) + 4) == data + b"tail"
    await until(recorder, "drained")
    assert transport.writable
    assert await asyncio.get_running_loop().sock_recv(other, 1) == b""
    other.close()
    await until(recorder, "lost")
    assert recorder.events == ["drained", "eof", "lost"]


@pytest.mark.parametrize("limited", [False, True])
async def test_the_kernel_takes_little_more_than_it_can_send(limited: bool) -> None:
    """The peer reads nothing: what the kernel holds unsent would wait for a slow line."""
    transport, _, other = pair()
    if limited:
        transport.limit_unsent()
    size = 40_000_000
    transport.write(bytes(size))
    unsent = bytearray(4)
    fcntl.ioctl(transport._fd, 0x894B, unsent)  # SIOCOUTQNSD (linux/sockios.h)
    held = struct.unpack("I", unsent)[0]
    assert (held < 300_000) is limited, "one buffer of the kernel more than the limit"
    assert await asyncio.wait_for(swallow(other, size), 30) == bytes(size)
    other.close()
    transport.abort()


async def test_pending_bytes_are_sent_after_the_peers_end() -> None:
    transport, recorder, other = pair()
    transport.write(bytes(10_000_000))
    other.shutdown(socket.SHUT_WR)
    await until(recorder, "eof")
    transport.resume_reading()  # there is nothing more to read
    assert not transport.closed
    await swallow(other, 10_000_000)
    await until(recorder, "lost")
    other.close()


async def test_a_reset_while_writing() -> None:
    transport, recorder, other = pair()
    transport.write(bytes(10_000_000))
    other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
    other.close()
    await until(recorder, "lost")
    transport.write(b"nobody reads this")
    transport.write_eof()
    transport.resume_reading()
    transport.abort()
    assert recorder.events == ["lost"]
    assert transport.backlog == 0


async def test_a_write_to_a_peer_that_left() -> None:
    transport, recorder, other = pair()
    transport.pause_reading()
    other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
    other.close()
    transport.write(b"x")
    transport.write(b"x")
    transport.write_eof()
    await until(recorder, "lost")


async def test_a_spurious_wake_up_reads_nothing() -> None:
    transport, recorder, other = pair()
    transport._readable()
    other.sendall(b"x")
    await asyncio.sleep(0.01)
    assert recorder.got == b"x"
    transport.abort()
    other.close()
    await until(recorder, "lost")


async def test_the_local_address_is_the_sockets() -> None:
    transport, recorder, other = pair()
    assert transport.local_address == "127.0.0.1"
    transport.abort()
    assert transport.local_address == ""
    await until(recorder, "lost")
    other.close()


class HalfOpenLimits(Recorder):
    """Goes on sending after the peer's end."""

    def eof_received(self) -> bool:
        self._note("eof")
        return True


async def test_an_owner_may_go_on_sending_after_the_peers_end() -> None:
    transport, recorder, other = pair(HalfOpenLimits())
    other.shutdown(socket.SHUT_WR)
    await until(recorder, "eof")
    assert not transport.closed
    transport.write(bytes(1_000_000))
    transport.finish()
    assert len(await swallow(other, 1_000_000)) == 1_000_000
    await until(recorder, "lost")
    other.close()


async def test_a_reset_is_no_end() -> None:
    transport, recorder, other = pair()
    transport.reset()
    transport.reset()
    with other, pytest.raises(ConnectionResetError):
        other.recv(1)
    await until(recorder, "lost")


class Full(Recorder):
    """Has no room until it is told so."""

    transport: Transport
    full = True

    def get_buffer(self) -> memoryview:
        if self.full:
            self.transport.pause_reading()
            self._note("full")
            raise BlockingIOError
        return super().get_buffer()


async def test_an_owner_without_room_reads_later_in_its_own_turn() -> None:
    owner = Full()
    transport, recorder, other = pair(owner)
    owner.transport = transport
    other.sendall(b"x")
    await until(recorder, "full")
    assert not transport.reading
    owner.full = False
    transport.read_now()
    assert recorder.got == b"x"
    transport.abort()
    transport.read_now()
    await until(recorder, "lost")
    other.close()
