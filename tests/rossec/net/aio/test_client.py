"""A connection that comes to nothing gives its socket back."""

import asyncio
import socket

import pytest

from rossec.errors import ForeignIdentity, PeerRefused, PeerUnreachable, PlainPeer
from rossec.net.aio import client as module
from rossec.net.aio import connect
from tests.support.contexts import context
from tests.support.wire import ALICE, trust


@pytest.fixture
def dialled(monkeypatch: pytest.MonkeyPatch) -> socket.socket:
    """What `connect` gets from the dial: a socket whose peer is gone already."""
    sock = socket.socket()

    async def dial(host: str, port: int, within: float) -> socket.socket:
        return sock

    monkeypatch.setattr(module, "dial", dial)
    return sock


async def test_a_connection_that_is_reset_at_once(dialled: socket.socket) -> None:
    with pytest.raises(PeerUnreachable, match="reset at once") as caught:
        await connect("127.0.0.1", 1, context(ALICE, trust))
    assert caught.value.hint
    assert dialled.fileno() == -1


async def test_a_handshake_that_cannot_begin(dialled: socket.socket) -> None:
    with pytest.raises(IndexError):
        await connect("127.0.0.1", 1, context(ALICE, trust, suites=()))
    assert dialled.fileno() == -1


async def test_a_cancelled_handshake() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        calling = asyncio.get_running_loop().create_task(connect("127.0.0.1", port, context(ALICE, trust)))
        peer, _ = await asyncio.to_thread(listener.accept)
        calling.cancel()
        with pytest.raises(asyncio.CancelledError):
            await calling
        peer.settimeout(10)
        with peer:
            while peer.recv(4096):
                pass  # until the end, which is there without a garbage collection


def test_where_the_peer_is_the_master_the_hint_says_how_to_start_it() -> None:
    down = module.as_master(PeerUnreachable("cannot connect", module._NOT_RUNNING))
    assert (str(down), down.hint) == ("cannot connect", module._START_MASTER)
    assert module.as_master(PeerUnreachable("reset", "overloaded")).hint == "overloaded"


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (TimeoutError(), "it does not answer"),
        (ConnectionRefusedError(111, "Connection refused"), "connection refused"),
        (ConnectionRefusedError(111, "Connect call failed ('::1', 4)"), "connection refused"),
        (socket.gaierror(-2, "Name or service not known"), "name or service not known"),
        (OSError("Multiple exceptions"), "Multiple exceptions"),
        (ValueError("bad port"), "bad port"),
    ],
)
def test_the_reason_is_for_people(error: Exception, reason: str) -> None:
    assert module._reason(error) == reason


def test_what_should_be_the_master_and_is_not_is_said() -> None:
    plain = module.as_master(PlainPeer("the peer is a plain HTTP server and says: 501", "x"))
    assert isinstance(plain, PlainPeer)
    assert "roscore perhaps: the peer is a plain HTTP server and says: 501" in str(plain)
    foreign = module.as_master(ForeignIdentity("the peer's certificate is refused", "x"))
    assert isinstance(foreign, ForeignIdentity)
    assert "of another authority: " in str(foreign)
    assert "ROS_MASTER_URI" in foreign.hint
    other = PeerRefused("no", "hint")
    assert module.as_master(other) is other
