"""The node that this process is, thread-safe, and the connections it makes, both ways."""

import socket
import struct
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial, wraps
from threading import RLock
from typing import Any, Concatenate, Final, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

from ca.certificates import Identity
from rossec import clock, errors
from rossec.channel.edhoc.credentials import Credentials
from rossec.channel.edhoc.suites import OFFERED_SUITES
from rossec.channel.negotiation import Renewal
from rossec.channel.opening import MAX_DRAIN, PlainCaller, WireProtocol, classify_caller
from rossec.home import NodeHome
from rossec.net.context import SecureContext
from rossec.net.limits import HalfOpenSlot
from rossec.net.threads.secure_socket import SecureSocket
from rossec.participant.access import Access
from rossec.participant.connections import Address, OwnAddresses
from rossec.participant.handshakes import caller_for
from rossec.participant.membership import LoadedIdentity
from rossec.ros import names, tcpros

P = ParamSpec("P")
R = TypeVar("R")
_READ: Final = 256 * 1024
_PREFIX: Final = 4
DEADLINE: Final = 5.0
CONNECT_TIMEOUT: Final = 10.0
Stream = SecureSocket[Identity]


def _locked(method: Callable[Concatenate[Access, P], R]) -> Callable[Concatenate["LockedAccess", P], R]:
    @wraps(method)
    def call(locked: "LockedAccess", /, *args: P.args, **kwargs: P.kwargs) -> R:
        with locked.lock:
            value: R = getattr(locked._access, method.__name__)(*args, **kwargs)  # noqa: SLF001
            return value

    return call


class LockedAccess:
    """What this process uses of `Access`, one thread at a time."""

    # Not a subclass: a method that is added to `Access` cannot be called here without the lock. One lock
    # makes a list and its confirmation one step: between the two no revocation data would be fresh, and
    # every peer that is checked would be refused.

    def __init__(self, access: Access) -> None:
        self._access = access
        self.lock = RLock()

    @property
    def epoch(self) -> int:
        with self.lock:
            return self._access.epoch

    @property
    def unproved(self) -> list[bytes]:
        with self.lock:
            return self._access.unproved

    @property
    def foreign_domains(self) -> frozenset[str]:
        with self.lock:
            return self._access.foreign_domains

    hold = _locked(Access.hold)
    hold_renewed = _locked(Access.hold_renewed)
    held_grants = _locked(Access.held_grants)
    update_revocations = _locked(Access.update_revocations)
    expire_confirmation = _locked(Access.expire_confirmation)
    add_proof = _locked(Access.add_proof)
    current = _locked(Access.current)
    present = _locked(Access.present)
    holds = _locked(Access.holds)
    is_master = _locked(Access.is_master)
    check_peer = _locked(Access.check_peer)
    authorize = _locked(Access.authorize)


class LocalIdentity(LoadedIdentity):
    def __init__(
        self, home: NodeHome, name: str, suites: tuple[int, ...] = OFFERED_SUITES, master: str = names.MASTER
    ) -> None:
        super().__init__(home, name, master)
        self.live_context = SecureContext(
            self.live_credentials, self.anchors.verify, suites=suites, renews=Identity.renews
        )
        self.access = LockedAccess(Access(self.trust_status, master=master))

    def name_for(self, peer: Identity) -> str:
        return caller_for(peer, self.name, self.identity.name)

    @property
    def credentials(self) -> Credentials:
        return self.live_credentials.current

    @property
    def context(self) -> SecureContext[Identity]:
        # The context of the next handshake: a renewal by another thread does not change it.
        return replace(self.live_context, credentials=self.credentials)

    def refresh_identity(self) -> bool:
        credentials = self.home.credentials()
        if credentials.chain == self.credentials.chain:
            return False
        self.identity = self.home.identity(now())
        self.live_credentials.current = credentials
        return True


def now() -> int:
    """The host's clock, in seconds; never ROS time (attack M7)."""
    return clock.now()


class PlainSocketStream:
    """What is used of a `SecureSocket`, for what `allow_plain` names: the peer is not authenticated."""

    peer = None
    awaits_peer = False

    def __init__(self, sock: socket.socket) -> None:
        sock.settimeout(None)
        self._socket = sock

    def recv(self, size: int) -> bytes:
        return self._socket.recv(size)

    def recv_into(self, buffer: bytearray | memoryview, size: int = 0) -> int:
        return self._socket.recv_into(buffer, size)

    def receive_unit(self) -> bytes:
        return self._socket.recv(_READ)

    def pump(self) -> None: ...

    def sendall(self, *pieces: bytes | bytearray | memoryview) -> None:
        for piece in pieces:
            self._socket.sendall(piece)

    def settimeout(self, value: float | None) -> None:
        self._socket.settimeout(value)

    def gettimeout(self) -> float | None:
        return self._socket.gettimeout()

    def shutdown(self, how: int = socket.SHUT_RDWR) -> None:
        self._socket.shutdown(how)

    def close(self) -> None:
        self._socket.close()


def peek(sock: socket.socket) -> bytes:
    """The first bytes of a plain caller: a header, or the beginning of an HTTP request; else empty."""
    # Not consumed: a caller that is not named goes on with the handshake, which refuses it.
    end = time.monotonic() + DEADLINE
    try:
        first = _peek_bytes(sock, _PREFIX, end)
        verdict = classify_caller(first + b"\0" * 60)
        if first in (b"POST", b"GET "):
            return first
        if not isinstance(verdict, PlainCaller) or verdict.drain > MAX_DRAIN:
            return b""
        return _peek_bytes(sock, min(verdict.drain, _PREFIX + tcpros.HEADER_LIMIT), end)
    except (OSError, errors.ProtocolViolation):
        return b""
    finally:
        sock.settimeout(None)


def plain_fields(data: bytes) -> dict[str, bytes]:
    if len(data) < _PREFIX or struct.unpack_from("<I", data)[0] != len(data) - _PREFIX:
        return {}
    try:
        return tcpros.decode(data[_PREFIX:])
    except errors.HeaderRefused:
        return {}


def _peek_bytes(sock: socket.socket, size: int, end: float) -> bytes:
    data: Any = b""
    while len(data) < size and (left := end - time.monotonic()) > 0:
        sock.settimeout(left)
        peeked = sock.recv(size, socket.MSG_PEEK)
        if len(peeked) == len(data):
            if not peeked:
                break
            time.sleep(0.005)  # the kernel cannot wait for more than has arrived
        data = peeked
    return bytes(data)


class Connector:
    def __init__(self, local_identity: LocalIdentity, own_addresses: OwnAddresses | None = None) -> None:
        self._local_identity = local_identity
        self._own_addresses = OwnAddresses() if own_addresses is None else own_addresses
        self._slots: WeakKeyDictionary[socket.socket, HalfOpenSlot] = WeakKeyDictionary()

    def initiate(self, sock: socket.socket, protocol: WireProtocol, address: Address) -> Stream:
        return SecureSocket.initiate(
            sock,
            self._local_identity.context,
            protocol,
            to_itself=self._own_addresses.is_own(address),
            timeout=CONNECT_TIMEOUT,
        )

    def admit(self, sock: socket.socket, address: str) -> bool:
        # It counts until the peer is authenticated, or `sock` is closed.
        slot = self._local_identity.context.half_open.admit(address)
        if slot is not None:
            slot.bind(sock)
            self._slots[sock] = slot
        return slot is not None

    def release(self, sock: socket.socket) -> None:
        slot = self._slots.pop(sock, None)
        if slot is not None:
            slot.release()

    def respond(self, sock: socket.socket, protocol: WireProtocol) -> Stream:
        try:
            core = self._local_identity.context.responder(protocol)
            sock.settimeout(None)  # rospy sets a default for all sockets of the process
            return SecureSocket(sock, core, partial(self.release, sock))
        except BaseException:
            sock.close()
            self.release(sock)
            raise


class Renewing:
    """What is renewed on a connection of rospy's; on a plain one there is nothing to renew."""

    _stream: Stream | PlainSocketStream | None = None

    def on_renewal(self, callback: Callable[[Renewal[Identity]], None]) -> None:
        if isinstance(self._stream, SecureSocket):
            self._stream.on_renewal(callback)

    def present_grants(self, data: bytes) -> bool:
        return isinstance(self._stream, SecureSocket) and self._stream.present_grants(data)
