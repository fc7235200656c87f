"""What the hooks of one process share, without rospy."""

import asyncio
import errno
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from ca.certificates import Identity
from ca.revocation.lists import Timestamp, digest, open_list, sign_timestamp
from grants.decision import Decision
from grants.model import Right
from rossec.errors import ChannelClosed, ConfigurationError, PlainPeer
from rossec.inprocess.identity import LocalIdentity
from rossec.inprocess.options import PlainPeers
from rossec.inprocess.process import CallReporter, RosConnection, SecuredProcess
from rossec.participant.authorized import AuthorizedConnection
from rossec.ros.names import parse_uri
from tests.support.ports import free_port
from tests.support.site import Site
from tests.support.witness import until


class Lines:
    """What is reported."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.reporter = CallReporter(self.said.append)

    async def until(self, words: str) -> None:
        """Lines are written by a thread."""
        await until(lambda: any(words in line for line in self.said))


@pytest.fixture
def lines() -> Lines:
    return Lines()


@pytest.fixture
def nameless(lines: Lines) -> SecuredProcess:
    return SecuredProcess(lines.reporter, PlainPeers(["/open"]))


@pytest.fixture
def process(nameless: SecuredProcess, local_identity: LocalIdentity) -> Iterator[SecuredProcess]:
    """One that has begun, without a master."""
    nameless.begin(local_identity, ("127.0.0.1", free_port()))
    yield nameless
    nameless.background_loop.stop()


NEEDS_A_NAME = (
    "local_identity",
    "connector",
    "registrations",
    "background_loop",
    "membership",
    "connections",
)


@pytest.mark.parametrize("name", NEEDS_A_NAME)
def test_without_a_name_no_connection_can_be_made(nameless: SecuredProcess, name: str) -> None:
    assert not nameless.has_begun
    with pytest.raises(ConfigurationError, match="no name yet") as caught:
        getattr(nameless, name)
    assert "rospy.init_node" in caught.value.__notes__[0]
    with pytest.raises(ConfigurationError):
        nameless.require_begun()


def test_it_begins_early_if_the_name_is_known(
    nameless: SecuredProcess, local_identity: LocalIdentity
) -> None:
    begun: list[int] = []

    def begin() -> None:
        begun.append(1)
        nameless.begin(local_identity, ("127.0.0.1", free_port()))

    nameless.begin_early = begin
    assert nameless.local_identity is local_identity
    nameless.require_begun()
    assert begun == [1]
    nameless.background_loop.stop()


def test_what_has_begun_uses_one_identity(process: SecuredProcess, local_identity: LocalIdentity) -> None:
    assert process.has_begun
    assert process.local_identity is local_identity
    assert process.membership is process.background_loop.membership
    assert process.connections is process.background_loop.connections
    assert process.registrations is process.registrations
    assert process.connector is process.connector


async def test_the_background_loop_calls_the_master(
    nameless: SecuredProcess, site: Site, local_identity: LocalIdentity
) -> None:
    async with site.running():
        assert site.master is not None
        address = parse_uri(site.master.uri)
        await asyncio.to_thread(nameless.begin, local_identity, address)
        call = nameless.background_loop.call
        answer = await asyncio.to_thread(call, "getUri", ("/robot",))
        assert site.master.uri in str(answer)
        await asyncio.to_thread(nameless.background_loop.stop)


def test_ports_are_at_the_host_that_rospy_announces(nameless: SecuredProcess) -> None:
    nameless.listens(5000, "robot.local")
    nameless.listens(5001)
    for port in (5000, 5001):
        assert nameless.own_addresses.is_own(("robot.local", port))
    assert not nameless.own_addresses.is_own(("robot.local", 5002))


class Socket:
    """What the process uses of a socket."""

    def __init__(self, peer: Identity) -> None:
        self.peer = peer
        self.connection: object = None
        self.aborted: list[str] = []

    def disconnect(self) -> None:
        """`abort` follows."""

    def abort(self, reason: str = "") -> None:
        self.aborted.append(reason)


def admitted(sock: Any, *, ends: int = 1 << 40) -> RosConnection:
    decision = Decision(Right.SUBSCRIBE, "/a", (), ends, ())
    return AuthorizedConnection(sock, decision, None)


@pytest.fixture
def confirmed(site: Site, local_identity: LocalIdentity) -> None:
    """The revocation list is fresh."""
    data = site.authority.store.newest_list()
    assert data is not None
    signer, now = site.enroll("/master").credentials().signer, site.now()
    seq = open_list(data, site.anchor.public_key).seq
    timestamp = sign_timestamp(signer, Timestamp(seq, digest(data), now, 30))
    save = local_identity.home.save_revocations
    master = site.identity("/master")
    local_identity.access.update_revocations(data, timestamp, master, now, save)


@pytest.mark.usefixtures("confirmed")
def test_an_admitted_connection_is_kept_until_it_is_closed(process: SecuredProcess, site: Site) -> None:
    sock: Any = Socket(site.identity("/viewer"))
    process.connections.accept(sock, sock.peer)
    connection = admitted(sock)
    process.add_connection(sock, connection)
    assert sock.connection is connection
    assert list(process.connections) == [connection]
    process.connection_closed(sock)
    assert list(process.connections) == []
    assert sock.aborted == []


def test_a_connection_that_may_not_be_is_not_added(process: SecuredProcess, site: Site) -> None:
    sock: Any = Socket(site.identity("/viewer"))
    with pytest.raises(ChannelClosed, match="expired"):
        process.add_connection(sock, admitted(sock, ends=1))
    assert list(process.connections) == []


def test_a_socket_of_a_process_without_a_name_is_closed(nameless: SecuredProcess) -> None:
    sock: Any = SimpleNamespace(connection=None)
    nameless.connection_closed(sock)
    assert not nameless.has_begun


async def test_what_is_left_plain_is_warned_of(nameless: SecuredProcess, lines: Lines) -> None:
    assert nameless.allows_plain("/open", "10.0.0.1")
    assert not nameless.allows_plain("/closed", "10.0.0.1")
    await lines.until("PLAIN: /open with 10.0.0.1, neither encrypted nor checked")
    assert not any("/closed" in line for line in lines.said)


async def test_rospy_tries_again_unless_the_peer_is_plain(nameless: SecuredProcess, lines: Lines) -> None:
    address = ("10.0.0.7", 5000)
    again = nameless.connect_error(address, ChannelClosed("it hung up"))
    assert isinstance(again, ConnectionAbortedError)
    assert again.errno == errno.ECONNABORTED
    never = nameless.connect_error(address, PlainPeer("the peer is a plain ROS node"))
    assert not isinstance(never, ConnectionAbortedError)
    assert str(never) == "rossec: the peer is a plain ROS node"
    await lines.until("cannot connect to 10.0.0.7 port 5000: it hung up")
