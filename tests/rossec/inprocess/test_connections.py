"""A running node: which callers it serves and refuses, and what it logs."""

import asyncio
import socket
import xmlrpc.client
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio

from ca.encoding import encode
from grants.model import Restriction, Right, filter_rules
from rossec.errors import ChannelError, RossecError
from rossec.net.aio import connect
from rossec.net.rpc.calls import RpcClient
from rossec.participant.access import FIELD
from rossec.ros import tcpros
from rossec.ros.names import MASTER, PORTS, parse_uri
from rossec.ros.xmlrpc import Fault
from tests.support.attacker import HOST, call, credentials, dial, fields_for, send_header
from tests.support.contexts import unlimited
from tests.support.site import coarse
from tests.support.victim import SERVICE, STATE, TYPE, Victim, attacked
from tests.support.witness import until

pytestmark = [pytest.mark.ros, pytest.mark.asyncio(loop_scope="module")]
GUEST = "/guest"
Fields = dict[str, str | bytes]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def victim(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Victim]:
    directory: Path = tmp_path_factory.mktemp("victim")
    async with attacked(directory) as victim:
        victim.site.grant(GUEST, Right.SUBSCRIBE, "/robot/**")
        victim.site.grant(GUEST, Right.CALL, "/robot/**")
        yield victim


async def refusal(victim: Victim, **fields: str) -> str:
    """The error that a visitor with every right gets for a header."""
    grants = encode(list(victim.site.enroll(GUEST).grants()))
    own = credentials(victim.site, GUEST)
    answer = await send_header(victim.port, own, {"callerid": GUEST, FIELD: grants, **fields})
    await victim.goes_on(2)
    return answer.error


async def test_an_unknown_name_or_another_type_is_refused(victim: Victim) -> None:
    any_type = {"md5sum": "*", "type": "*"}
    assert await refusal(victim, topic="/robot/none", **any_type) == (
        "rossec: /robot does not publish /robot/none"
    )
    assert await refusal(victim, service="/robot/none", md5sum="*") == (
        "rossec: /robot does not provide /robot/none"
    )
    assert "types do not match" in await refusal(victim, topic=STATE, md5sum="0" * 32, type="std_msgs/Int32")
    assert "md5sums do not match" in await refusal(victim, service=SERVICE, md5sum="0" * 32)
    assert "has no 'topic'" in await refusal(victim, **any_type)


async def test_a_restriction_for_another_type_is_refused(victim: Victim) -> None:
    grant = victim.site.subscribe("/misfit", STATE, coarse())
    own = credentials(victim.site, "/misfit")
    answer = await send_header(victim.port, own, fields_for("/misfit", STATE, [grant]))
    assert "restricted for messages of type geometry_msgs/PoseStamped" in answer.error
    grant = victim.site.grant("/misfit", Right.CALL, SERVICE, restriction=coarse())
    fields: Fields = {"callerid": "/misfit", "service": SERVICE, "md5sum": "*", FIELD: encode([grant])}
    answer = await send_header(victim.port, own, fields)
    assert "restricted for messages of type geometry_msgs/PoseStamped" in answer.error


async def test_callers_that_disconnect_or_send_garbage_are_dropped(victim: Victim) -> None:
    with socket.create_connection((HOST, victim.port)):
        pass
    own = credentials(victim.site, GUEST)
    for data in (b"\xff\xff\xff\x7f", tcpros.frame(b"\x05\0\0\0nope!"), b"\x01"):
        stream = await connect(HOST, victim.port, unlimited(own, victim.site.anchor.verify))
        await stream.send(data)
        await stream.close()
    await until(lambda: "a connection header of 2147483647 bytes" in victim.said)
    await victim.goes_on()


async def test_a_service_is_probed_and_called_on_a_persistent_connection(victim: Victim) -> None:
    own = credentials(victim.site, GUEST)
    grants = encode(list(victim.site.enroll(GUEST).grants()))
    fields: Fields = {"callerid": GUEST, "service": SERVICE, "md5sum": "*", FIELD: grants}
    answer = await send_header(victim.port, own, {**fields, "probe": "1"})
    assert answer.fields["callerid"] == b"/robot"
    stream = await connect(HOST, victim.port, unlimited(own, victim.site.anchor.verify))
    await stream.send(tcpros.encode({**fields, "persistent": "1"}))
    await stream.receive()
    for request in (b"", bytes(30_000)):  # rospy ignores bytes after a request
        await stream.send(tcpros.frame(request))
        assert (await stream.receive())[0] == 1
    await stream.send(tcpros.frame(bytes(300_000)))  # rossec does not, where all requests have one size
    with pytest.raises(ChannelError):
        await stream.receive()
    victim.program.said = victim.said.replace("RESET", "")


async def test_a_large_request_passes_if_its_type_allows_it(victim: Victim) -> None:
    """Larger than a connection header: its caller is authorized."""
    own = credentials(victim.site, GUEST)
    grants = encode(list(victim.site.enroll(GUEST).grants()))
    service = "/robot/set_logger_level"
    fields: Fields = {"callerid": GUEST, "service": service, "md5sum": "*", FIELD: grants}
    stream = await connect(HOST, victim.port, unlimited(own, victim.site.anchor.verify))
    await stream.send(tcpros.encode(fields))
    await stream.receive()
    logger, level = b"rosout." + b"x" * 300_000, b"info"
    parts = (len(logger).to_bytes(4, "little"), logger, len(level).to_bytes(4, "little"), level)
    await stream.send(tcpros.frame(b"".join(parts)))
    assert (await stream.receive())[0] == 1
    await stream.close()


async def test_a_plain_caller_of_the_api_is_answered(victim: Victim) -> None:
    with xmlrpc.client.ServerProxy(victim.uri) as robot:
        answer = await asyncio.to_thread(robot.getPid, "/x")
    assert isinstance(answer, list)
    assert answer[0] == -1


async def test_the_api_survives_malformed_requests(victim: Victim) -> None:
    own = credentials(victim.site, GUEST)
    for data in (
        b"GET / HTTP/1.1\r\nHost: x\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: x\r\nContent-length: 3\r\n\r\nabc",
        b"POST / HTTP/1.1\r\nHost: x\r\nContent-length: 99999999\r\n\r\n",
        b"POST / HT",
    ):
        stream = await dial(victim.uri, own)
        await stream.send(data)
        if data.endswith(b"HT"):
            await stream.close()
        else:
            assert b"HTTP/1.1" in await stream.receive()
            stream.abort("enough")
    client = RpcClient(await dial(victim.uri, own))
    with pytest.raises(Fault):
        await client.call("", GUEST)
    await client.close()
    await victim.goes_on()


async def test_what_only_the_master_may_call_is_refused_to_others(victim: Victim) -> None:
    client = RpcClient(await dial(victim.uri, credentials(victim.site, GUEST)))
    answer = await client.call("publisherUpdate", GUEST, "/word", [])
    await client.close()
    assert isinstance(answer, list)
    assert answer[0] == -1
    await victim.goes_on()


async def test_only_a_relay_is_told_the_port_of_topics(victim: Victim) -> None:
    for name, answer in (
        ("/relay", [1, "", [victim.port]]),
        ("/relay/kitchen", [1, "", [victim.port]]),
        (GUEST, [-1, f"rossec: {PORTS} is for a relay alone", []]),
        (MASTER, [-1, f"rossec: {PORTS} is for a relay alone", []]),
    ):
        assert await call(victim.uri, credentials(victim.site, name), PORTS, name) == answer
    await victim.goes_on()


async def test_the_master_changes_parameters_and_publishers(victim: Victim) -> None:
    site = victim.site
    own = credentials(site, "/boss")
    site.grant("/boss", Right.PARAM_SET, "/robot/speed")
    assert site.master is not None
    grants = site.enroll("/boss").grants()
    await call(site.master.uri, own, "rossec.presentGrants", "/boss", grants)
    for value in (2, 1):
        await call(site.master.uri, own, "setParam", "/boss", "/robot/speed", value)
        await until(lambda value=value: victim.last.endswith(f" {value}"))  # type: ignore[misc]


async def test_a_publisher_that_goes_away_is_retried_then_dropped(victim: Victim) -> None:
    """The connection breaks, is made again, and is dropped when the master names it no longer."""
    site = victim.site
    site.publish("/commander", "/robot/command")
    async with site.node("/commander") as commander:
        publisher = await commander.publisher("/robot/command", TYPE)
        await publisher.wait_for_subscribers()
        publisher.publish(publisher.create(data="go"))
        await until(lambda: "COMMANDED go" in victim.said, within=20)
        for link in tuple(publisher.links):
            link.stream.abort("a test")
        await publisher.wait_for_subscribers(1)
        publisher.publish_bytes(b"\xff\xff\xff\x7f")
        await until(lambda: "lost /robot/command" in victim.said, within=20)
        uri = commander.uri
    victim.program.said = victim.said.replace("COMMANDED", "")
    with pytest.raises((ChannelError, RossecError, OSError)):
        await call(uri, credentials(site), "getPid", "/eve")
    assert parse_uri(uri)
    await victim.goes_on()


async def test_messages_of_a_restricted_publisher_are_filtered(victim: Victim) -> None:
    site = victim.site
    rules = filter_rules({"data": {"truncate": {"length": 2}}})
    restriction = Restriction(TYPE, ('msg.data != "stop"',), rules)
    site.grant("/limited", Right.PUBLISH, "/robot/command", restriction=restriction)
    async with site.node("/limited") as limited:
        publisher = await limited.publisher("/robot/command", TYPE)

        def obeyed() -> bool:
            for data in ("stop", "walk"):
                publisher.publish(publisher.create(data=data))
            publisher.publish_bytes(b"\x02\0\0\0go, and a tail")
            refused = "withheld a message on /robot/command" in victim.said
            return refused and "COMMANDED wa" in victim.said

        await until(obeyed, within=20)
    assert "COMMANDED stop" not in victim.said
    assert "walk" not in victim.said
    victim.program.said = victim.said.replace("COMMANDED", "")
    await victim.goes_on()


async def test_revocation_closes_connections(victim: Victim) -> None:
    site = victim.site
    grant = site.subscribe("/visitor", STATE)
    async with site.node("/visitor") as visitor:
        sight = await visitor.subscriber(STATE, TYPE)
        await until(lambda: sight.received > 0, within=20)
        eve = await dial(victim.uri, credentials(site))
        site.revoke(site.identity("/eve").thumbprint)
        data = site.revoke(grant)
        await victim.viewer._membership.session.call("rossec.updateRevocations", data)
        await until(lambda: "closed the connection with /visitor" in victim.said, within=20)
        async with asyncio.timeout(20):
            await eve.wait_ended()
    await victim.goes_on()


async def test_delivery_options_are_taken_by_a_publisher_with_a_queue(victim: Victim) -> None:
    options = {"rossec_rate": "9000.000", "rossec_newest": "1", "rossec_deflate": "1"}
    grants = list(victim.site.enroll(GUEST).grants())
    own = credentials(victim.site, GUEST)
    for said in (options, {}):
        fields = fields_for(GUEST, STATE, grants, **said)
        reply = await send_header(victim.port, own, fields, at_most=3000)
        assert {key: reply.fields[key].decode() for key in options if key in reply.fields} == said
        assert reply.after
    assert "'rossec_rate' is no rate" in await refusal(
        victim, topic=STATE, md5sum="*", type="*", rossec_rate="fast"
    )
