"""Calls of a service, frame by frame; no connection."""

import pytest

from ca.errors import HintedError
from grants.decision import Decision
from grants.errors import MessageRefused
from grants.model import Restriction, Right, filter_rules
from rossec.errors import ChannelClosed, ServiceRefused, WireError
from rossec.inprocess.sockets import ClientFilter, ServerFilter
from rossec.participant.service_types import ServiceGuard, service_type
from rossec.ros import tcpros as wire
from rossec.ros.tcpros import frame
from tests.support.memory_scopes import HOLDER, fresh

NOW = 1_000_000
ON, OFF = frame(b"\1"), frame(b"\0")
YES = b"\1" + frame(b"\1" + frame(b"secret"))
YES_CLEARED = b"\1" + frame(b"\1" + frame(b""))
NO = b"\1" + frame(b"\0" + frame(b""))

ONLY_OFF = Restriction("std_srvs/SetBoolRequest", ("!msg.data",))
CLEARED = Restriction(
    "std_srvs/SetBoolResponse", ("msg.success",), filter_rules({"message": {"clear": True}})
)


def guard(*restrictions: Restriction) -> ServiceGuard:
    decision = Decision(Right.CALL, "/lamp", (HOLDER,), NOW + 10, restrictions)
    return ServiceGuard(service_type("std_srvs/SetBool"), decision, lambda _: b"", fresh())


class Server(ServerFilter):
    def __init__(self, *restrictions: Restriction) -> None:
        self.reason: str | None = None
        self.refusals: list[HintedError] = []
        restricted = guard(*restrictions) if restrictions else None
        super().__init__(self.check, restricted, self.refusals.append, lambda: NOW)

    def check(self) -> None:
        if self.reason is not None:
            raise ChannelClosed(self.reason)


def test_only_whole_requests_pass() -> None:
    server = Server()
    assert server.incoming(ON[:3]) == (b"", ())
    assert server.incoming(ON[3:]) == (ON, ())
    assert server.outgoing(YES) == (YES,)


def test_a_request_is_bounded_and_comes_alone() -> None:
    with pytest.raises(WireError, match="at most"):
        Server().incoming(b"\xff\xff\xff\xff")
    with pytest.raises(WireError, match="before its answer"):
        Server().incoming(ON + ON)


def test_each_request_is_authorized() -> None:
    server = Server()
    server.incoming(ON)
    server.reason = "its grant has expired"
    with pytest.raises(ChannelClosed, match="its grant has expired"):
        server.incoming(ON)


def test_a_refused_request_is_answered_with_the_reason() -> None:
    server = Server(ONLY_OFF)
    allowed, reply = server.incoming(ON)
    assert allowed == b""
    assert b"does not allow this request" in b"".join(reply)
    assert reply[0] == b"\0"
    [error] = server.refusals
    assert isinstance(error, ServiceRefused)
    assert server.incoming(OFF) == (OFF, ())


def test_a_response_is_filtered_for_the_caller() -> None:
    server = Server(CLEARED)
    assert b"".join(server.outgoing(YES)) == YES_CLEARED
    assert b"secret" not in b"".join(server.outgoing(YES))
    assert b"does not allow this response" in b"".join(server.outgoing(NO))
    failed = b"".join(wire.failure("it broke"))
    assert server.outgoing(failed) == (failed,)


def test_a_malformed_response_is_refused() -> None:
    server = Server(CLEARED)
    assert server.outgoing(b"\1" + frame(b"\1"))[0] == b"\0"
    assert isinstance(server.refusals[0], MessageRefused)


def test_a_caller_applies_the_grant_of_its_provider() -> None:
    client = ClientFilter(guard(CLEARED, ONLY_OFF), lambda: NOW)
    assert b"".join(client.outgoing(OFF)) == OFF
    with pytest.raises(ServiceRefused):
        client.outgoing(ON)
    assert client.incoming(YES[:7]) == (b"", ())
    assert client.incoming(YES[7:]) == (YES_CLEARED, ())
    refused, reply = client.incoming(NO)
    assert refused.startswith(b"\0")
    assert b"rossec: " in refused
    assert reply == ()
    failed = b"".join(wire.failure("it broke"))
    assert client.incoming(failed) == (failed, ())
