"""What a context gives each of its connections: credentials, limits, dials to itself."""

import dataclasses
import subprocess
import sys
from collections.abc import Sequence

import pytest

from rossec import clock
from rossec.channel.edhoc.credentials import KnownCertificates, LiveCredentials
from rossec.channel.edhoc.suites import POST_QUANTUM
from rossec.channel.negotiation import Authenticated
from rossec.channel.opening import WireProtocol
from rossec.errors import HandshakeFailed, IdentityRefused, LimitExceeded, PlainPeer
from rossec.net.context import SecureContext
from rossec.net.limits import ACCEPTED, DIALLED, PREAUTH_LIMIT
from tests.support.wire import ALICE, BOB, NOW, FakeIdentity, Wire, node, peers, trust, wire

Context = SecureContext[FakeIdentity]
TCPROS = WireProtocol.TCPROS


@pytest.fixture(autouse=True)
def host_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock, "now", lambda: NOW)


class Told:
    """A connection that is told of a renewed certificate."""

    def __init__(self, told: list[object]) -> None:
        self._told = told

    def present_identity(self, chain: Sequence[bytes]) -> None:
        self._told.append(chain)


def connected(left: Context, right: Context, *, to_itself: bool = False) -> Wire:
    return wire(left.initiator(TCPROS, to_itself=to_itself), right.responder(TCPROS)).pump()


@pytest.mark.parametrize("protocol", list(WireProtocol))
def test_both_sides_are_authenticated(protocol: WireProtocol) -> None:
    left, right = SecureContext(ALICE, trust), SecureContext(BOB, trust)
    w = wire(left.initiator(protocol), right.responder(protocol)).pump()
    assert (peers(w.left), peers(w.right)) == (["/bob"], ["/alice"])


def test_another_protocol_is_refused() -> None:
    left, right = SecureContext(ALICE, trust), SecureContext(BOB, trust)
    w = wire(left.initiator(WireProtocol.HTTP), right.responder(TCPROS)).pump()
    assert isinstance(w.right.error, PlainPeer)
    assert not w.right.events


@pytest.mark.parametrize("protocol", list(WireProtocol))
def test_the_limits_are_those_of_the_protocol(protocol: WireProtocol) -> None:
    context = SecureContext(ALICE, trust)
    assert context.initiator(protocol).unit_limit == DIALLED[protocol].unit
    assert context.responder(protocol).unit_limit == ACCEPTED[protocol].unit


def test_an_accepted_peer_may_send_a_header_at_first() -> None:
    w = connected(SecureContext(ALICE, trust), SecureContext(BOB, trust))
    w.left.core.send_unit(bytes(PREAUTH_LIMIT + 1))
    w.pump()
    assert isinstance(w.right.error, LimitExceeded)


def test_a_protocol_without_limits_is_not_used() -> None:
    context: Context = SecureContext(ALICE, trust, dial_limits={}, accept_limits={})
    for make in (context.initiator, context.responder):
        with pytest.raises(KeyError):
            make(TCPROS)


def test_credentials_are_read_at_each_handshake() -> None:
    live = LiveCredentials(ALICE)
    left, right = SecureContext(live, trust), SecureContext(BOB, trust)
    assert peers(connected(left, right).right) == ["/alice"]
    live.current = node("/carol")
    assert peers(connected(left, right).right) == ["/carol"]


def test_the_policy_is_that_of_both_sides() -> None:
    strict = SecureContext(BOB, trust, suites=POST_QUANTUM["require"])
    w = connected(SecureContext(ALICE, trust), strict)
    assert isinstance(w.left.error, HandshakeFailed)
    w = connected(SecureContext(ALICE, trust, suites=POST_QUANTUM["require"]), strict)
    assert peers(w.left) == ["/bob"]


def test_known_certificates_are_named_on_request() -> None:
    left = SecureContext(ALICE, trust, known=KnownCertificates())
    right = SecureContext(BOB, trust, known=KnownCertificates())
    by_value = connected(left, right)
    by_hash = wire(left.initiator(TCPROS, request_x5t=True), right.responder(TCPROS)).pump()
    assert peers(by_hash.left) == ["/bob"]
    assert len(by_hash.right.sent[0]) < len(by_value.right.sent[0])


def test_an_identity_reaches_itself_where_it_means_to() -> None:
    own = SecureContext(ALICE, trust)
    w = connected(own, own, to_itself=True)
    assert all(isinstance(end.events[0], Authenticated) for end in (w.left, w.right))
    assert isinstance(connected(own, own).left.error, IdentityRefused)
    other_process = SecureContext(ALICE, trust)
    for other in other_process, SecureContext(BOB, trust):
        w = connected(own, other, to_itself=True)
        assert isinstance(w.left.error, IdentityRefused)


def test_a_copy_shares_what_is_counted() -> None:
    own = SecureContext(ALICE, trust)
    renewed = dataclasses.replace(own, credentials=node("/alice"))
    assert renewed.half_open is own.half_open
    assert renewed.self_connections is own.self_connections
    assert SecureContext(ALICE, trust).half_open is not own.half_open


@pytest.mark.parametrize(
    ("module", "others"),
    [
        ("rossec.net.context", {"asyncio", "numpy", "rossec.net.aio", "rossec.net.threads"}),
        ("rossec.net.threads.secure_socket", {"asyncio", "numpy", "rossec.net.aio"}),
        ("rossec.net.aio", {"numpy", "rossec.net.threads"}),
    ],
)
def test_what_a_user_need_not_import(module: str, others: set[str]) -> None:
    text = f"import sys, {module}; print(*sorted({others!r} & sys.modules.keys()))"
    run = subprocess.run([sys.executable, "-I", "-c", text], capture_output=True, check=True)
    assert run.stdout.split() == []


def test_a_context_that_takes_renewals_presents_its_own_where_it_is_connected() -> None:
    live = LiveCredentials(ALICE)
    left: Context = SecureContext(live, trust, renews=lambda new, old: new.name == old.name)
    right: Context = SecureContext(BOB, trust, renews=lambda new, old: new.name == old.name)
    core = left.initiator(TCPROS)
    w = wire(core, right.responder(TCPROS)).pump()
    assert peers(w.left) == ["/bob"]
    assert core.streams is left.open_streams
    told: list[object] = []
    kept = Told(told)
    left.open_streams.add(kept)
    live.current = ALICE
    assert told[-1] == ALICE.chain
