"""Loopback ports for peers: what programs receive, and what not."""

import logging
from pathlib import Path

import pytest

from grants.model import Restriction, Right, filter_rules
from rossec.channel.opening import WireProtocol
from rossec.errors import RossecError
from rossec.net.aio.client import dial
from rossec.ros import tcpros
from rossec.ros.names import parse_uri
from rossec.sidecar import egress as module
from rossec.sidecar.core.layers import ListeningAddress, parse_endpoint
from rossec.sidecar.loopback_port import PlainStream
from tests.rossec.sidecar.program import string_message
from tests.rossec.sidecar.sidecar_pair import SidecarPair, connect, receive_bytes, wait_closed
from tests.support.aliasforms import behind_a_sidecar
from tests.support.gateways import SERVED, STRING, two_sites
from tests.support.witness import until


async def provide(pair: SidecarPair) -> ListeningAddress:
    """The talker provides /say; the listener's loopback port for it."""
    uri = f"rosrpc://127.0.0.1:{pair.talker.topics.port}"
    await pair.talker.register("registerService", "/say", uri)
    answer = await pair.listener.ask(pair.listener.master_uri, "lookupService", "/say")
    assert isinstance(answer, list)
    endpoint = parse_endpoint(answer[2], WireProtocol.TCPROS)
    assert endpoint is not None
    return endpoint


async def test_messages_of_a_restricted_publisher_are_filtered_on_receipt(pair: SidecarPair) -> None:
    """Its own sidecar sends everything; the subscriber's sidecar applies the restriction."""
    for file in pair.site.enroll("/talker").path.glob("grants/*"):
        file.unlink()
    rules = filter_rules({"data": {"truncate": {"length": 2}}})
    restriction = Restriction("std_msgs/String", ('msg.data != "stop"',), rules)
    pair.site.grant("/talker", Right.PUBLISH, "/word", restriction=restriction)
    stream, source = await connect(pair)
    await source.send(string_message("hello") + string_message("stop") + string_message("world"))
    expected = string_message("he") + string_message("wo")
    assert await receive_bytes(stream, len(expected)) == expected


async def test_service_calls_are_forwarded_both_ways(pair: SidecarPair) -> None:
    endpoint = await provide(pair)
    stream, fields = await pair.listener.connect(endpoint, {"service": b"/say", "md5sum": b"*"})
    assert "error" not in fields
    await stream.send(string_message("echo"))
    assert await receive_bytes(stream, 12) == string_message("echo")
    stream.abort()


async def test_a_program_that_may_not_is_told_why(
    pair: SidecarPair, caplog: pytest.LogCaptureFixture
) -> None:
    endpoint = await provide(pair)
    wanted = {"service": b"/shout", "md5sum": b"*"}
    stream, fields = await pair.listener.connect(endpoint, wanted)
    assert fields["error"].startswith(b"rossec: ")
    await wait_closed(stream)
    assert "no connection to http" in caplog.text or "no connection to rosrpc" in caplog.text


async def test_a_refusal_of_a_call_is_logged_here_too(
    pair: SidecarPair, caplog: pytest.LogCaptureFixture
) -> None:
    """Stock `rosnode kill` says that it killed a node that refused."""
    await pair.talker.register("registerPublisher", "/word", "std_msgs/String")
    uris = await pair.listener.register("registerSubscriber", "/word", "std_msgs/String")
    assert isinstance(uris, list)
    answer = await pair.listener.ask(uris[0], "shutdown", "because")
    assert isinstance(answer, list)
    assert answer[0] == -1
    assert "refuses shutdown: no grant for admin on /talker" in caplog.text


async def test_a_program_without_a_header_in_time_is_disconnected(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    endpoint = await provide(pair)
    monkeypatch.setattr(module, "HEADER_DEADLINE", 0.05)
    stream = PlainStream(await dial(endpoint.host, endpoint.port, 10))
    await stream.send(tcpros.encode({"service": b"/say"})[:6])
    await wait_closed(stream)
    assert "a connection to " in caplog.text


async def test_a_peer_that_is_gone_hangs_up(pair: SidecarPair, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    endpoint = await provide(pair)
    await pair.talker_sidecar.close()
    stream = PlainStream(await dial(endpoint.host, endpoint.port, 10))
    await stream.send(tcpros.encode({"service": b"/say", "md5sum": b"*", "callerid": b"/listener"}))
    await wait_closed(stream)
    await until(lambda: "no connection to " in caplog.text)


async def test_a_topic_that_could_not_be_connected_is_subscribed_again(pair: SidecarPair) -> None:
    """Stock rospy gives it up after a connection without an answer."""
    await pair.talker.register("registerPublisher", "/word", "std_msgs/String")
    uris = await pair.listener.register("registerSubscriber", "/word", "std_msgs/String")
    assert isinstance(uris, list)
    answer = await pair.listener.ask(uris[0], "requestTopic", "/word", [["TCPROS"]])
    assert isinstance(answer, list)
    await pair.talker.topics.close()
    topics = ListeningAddress(WireProtocol.TCPROS, *answer[2][1:])
    with pytest.raises(RossecError):
        await pair.listener.connect(topics, {"topic": b"/word", "type": b"*", "md5sum": b"*"})

    def named() -> list[object]:
        return [call[1][1] for call in pair.listener.calls if call[0] == "publisherUpdate"]

    await until(lambda: named() == ["/word"], within=20)


async def test_the_port_of_a_dead_peer_refuses_callers(pair: SidecarPair) -> None:
    pair.site.grant("/listener", Right.GRAPH, "/talker")
    await pair.talker.register("registerPublisher", "/word", "std_msgs/String")
    await pair.talker_sidecar.close()
    answer = await pair.listener.ask(pair.listener.master_uri, "lookupNode", "/talker")
    assert isinstance(answer, list)
    with pytest.raises(ConnectionRefusedError):
        await dial(*parse_uri(answer[2]), 10)


async def test_a_publisher_of_an_alias_is_left_when_it_is_listed_no_longer(tmp_path: Path) -> None:
    """A program as rospy's leaves none by itself; one of the own domain stays, as ROS has it."""
    async with two_sites(tmp_path) as sites, sites.home.node("/gateway") as gateway:
        publisher = await gateway.publisher(SERVED, STRING)
        async with behind_a_sidecar(sites, tmp_path) as form:
            await sites.lead(form.uri, gateway.uri)
            await publisher.wait_for_subscribers()
            await sites.lead(form.uri, gateway.uri, "http://127.0.0.1:1/")
            await sites.lead(form.uri, "http://127.0.0.1:1/")
            await until(lambda: not publisher.links)
