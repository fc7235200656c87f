"""Unauthorized peers at the ports of real nodes: each is refused with its own error."""

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

from ca.errors import CAError, ForeignCertificate, Revoked
from grants import document
from grants import document as claims
from grants.errors import (
    GrantError,
    GrantExpired,
    GrantForged,
    GrantMalformed,
    GrantMissing,
    GrantNotHeld,
    GrantNotYetValid,
    GrantRevoked,
)
from grants.model import Right
from rossec.errors import ConnectionHeaderRefused, IdentityRefused, PeerRefused, RossecError
from rossec.net.aio import connect
from rossec.net.rpc.calls import RpcClient
from rossec.ros import tcpros
from rossec.ros.names import MASTER, REVOCATION_UPDATE
from tests.support.attacker import (
    EVE,
    HOST,
    call,
    credentials,
    dial,
    drafted,
    expect_no_room,
    expect_refused,
    fields_for,
    flip,
    refusals,
    revoke,
    send_header,
    signed,
)
from tests.support.contexts import unlimited
from tests.support.site import DAY, Site
from tests.support.witness import FRAME, TOPIC, Witness, until

N: Final = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551  # order of P-256


def past(site: Site) -> bytes:
    now = int(time.time())
    return signed(site, not_before=now - 60, expires=now - 1, cap=now - 1)


def future(site: Site) -> bytes:
    now = int(time.time())
    return signed(site, not_before=now + 3600, expires=now + DAY)


def another_key(site: Site) -> bytes:
    return signed(site, holder=site.identity("/viewer").thumbprint, subject="/viewer")


def own_key(site: Site) -> bytes:
    """Signed by a certified node, which it names as its issuer."""
    return signed(site, credentials(site).signer)


def in_the_name_of_the_authority(site: Site) -> bytes:
    """Signed by a node, but naming the authority as its issuer (attack D5)."""
    issuer = site.anchor.thumbprint
    return document.GRANT.sign(credentials(site).signer, claims.from_draft(drafted(site), issuer))


def another_authority(site: Site) -> bytes:
    other = Site(site.root.parent / "elsewhere")
    return signed(site, other.authority.signer)


def another_kind(site: Site) -> bytes:
    """A valid statement of the authority that is not a grant: the revocation list."""
    data = site.authority.store.newest_list()
    assert data is not None
    return data


def tampered(place: Callable[[bytes], int]) -> Callable[[Site], bytes]:
    def tamper(site: Site) -> bytes:
        data = signed(site)
        return flip(data, place(data))

    return tamper


def publish_only(site: Site) -> bytes:
    return signed(site, right=Right.PUBLISH)


CASES: Final[list[tuple[str, Callable[[Site], bytes], type[GrantError], str]]] = [
    ("expired", past, GrantExpired, "expired"),
    ("not yet valid", future, GrantNotYetValid, "is not valid before"),
    ("another key", another_key, GrantNotHeld, "bound to another key"),
    ("another topic", lambda s: signed(s, pattern="/robot/scan"), GrantMissing, "no grant for"),
    ("a longer topic", lambda s: signed(s, pattern=TOPIC + "x"), GrantMissing, "no grant for"),
    ("below the topic", lambda s: signed(s, pattern=TOPIC + "/**"), GrantMissing, "no grant for"),
    ("another right", publish_only, GrantMissing, "no grant for"),
    ("another domain", lambda s: signed(s, domain="work"), GrantForged, "trust domain"),
    ("signed by a node", own_key, GrantForged, "does not verify"),
    ("in the authority's name", in_the_name_of_the_authority, GrantForged, "does not verify"),
    ("another authority", another_authority, GrantForged, "does not verify"),
    ("another kind", another_kind, GrantForged, "not a statement of kind"),
    ("first byte", tampered(lambda _: 0), GrantForged, "not a COSE_Sign1"),
    ("the topic", tampered(lambda data: data.index(b"/robot")), GrantForged, "does not verify"),
    ("last byte", tampered(lambda data: len(data) - 1), GrantForged, "does not verify"),
    ("a byte more", lambda s: signed(s) + b"\0", GrantMalformed, "not a grant"),
    ("a byte less", lambda s: signed(s)[:-1], GrantMalformed, "not a grant"),
    ("nothing", lambda _: b"", GrantForged, "not a COSE_Sign1"),
]


@pytest.mark.attack("bad-grant")
@pytest.mark.parametrize(("make", "kind", "said"), [c[1:] for c in CASES], ids=[c[0] for c in CASES])
async def test_an_invalid_grant_is_refused_with_its_own_error(
    site: Site,
    witness: Witness,
    caplog: pytest.LogCaptureFixture,
    make: Callable[[Site], bytes],
    kind: type[GrantError],
    said: str,
) -> None:
    heard = await send_header(witness.topic_port, credentials(site), fields_for(EVE, TOPIC, [make(site)]))
    expect_refused(heard, caplog, kind, said)


@pytest.mark.attack("bad-grant")
async def test_a_valid_grant_is_accepted(site: Site, witness: Witness) -> None:
    """The control: all others are refused for their flaw only."""
    fields = fields_for(EVE, TOPIC, [signed(site)])
    heard = await send_header(witness.topic_port, credentials(site), fields, at_most=4096)
    assert "error" not in heard.fields
    assert FRAME.encode() in heard.after
    await until(lambda: len(witness.publisher.links) == 1)


@pytest.mark.attack("no-grant")
@pytest.mark.parametrize("grants", [None, []], ids=["no field", "an empty list"])
async def test_nodes_without_a_grant_are_refused(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture, grants: list[bytes] | None
) -> None:
    heard = await send_header(witness.topic_port, credentials(site), fields_for(EVE, TOPIC, grants))
    expect_refused(heard, caplog, GrantMissing, "subscribe")


@pytest.mark.attack("bad-grant")
@pytest.mark.parametrize(
    "presented", [b"", b"\x60", b"\x81\x01", b"\x9f\xff", b"\x80\x80", b"\x81" * 99, b"\xff" * 40]
)
async def test_an_invalid_list_of_grants_is_refused(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture, presented: bytes
) -> None:
    fields = {**fields_for(EVE, TOPIC, None), "rossec_grants": presented}
    heard = await send_header(witness.topic_port, credentials(site), fields)
    expect_refused(heard, caplog, GrantMalformed, "grants")


@pytest.mark.attack("bad-grant")
async def test_too_many_grants_are_refused_unopened(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    fields = fields_for(EVE, TOPIC, [signed(site)] * 17)
    heard = await send_header(witness.topic_port, credentials(site), fields)
    expect_refused(heard, caplog, GrantMalformed, "at most 16")


@pytest.mark.attack("bad-grant")
def test_no_bit_of_a_grant_can_be_changed(tmp_path: Path) -> None:
    site = Site(tmp_path)
    data = signed(site)
    assert document.open_grant(data, site.anchor.public_key, int(time.time())).subject == EVE
    for position in range(len(data)):
        for bit in range(8):
            with pytest.raises((GrantForged, GrantMalformed)):
                document.open_grant(flip(data, position, 1 << bit), site.anchor.public_key, int(time.time()))


@pytest.mark.attack("bad-grant")
async def test_a_revoked_grant_is_refused_and_so_is_its_malleated_twin(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    """ECDSA: (r, n - s) verifies where (r, s) does; the revocation must cover both."""
    grant = signed(site)
    twin = grant[:-32] + (N - int.from_bytes(grant[-32:])).to_bytes(32)
    await revoke(site, witness, grant)
    for data in (grant, twin):
        fields = fields_for(EVE, TOPIC, [data])
        heard = await send_header(witness.topic_port, credentials(site), fields)
        expect_refused(heard, caplog, GrantRevoked, "revoked")


@pytest.mark.attack("outlived-right")
async def test_a_revoked_node_is_refused_everywhere(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    eve, grant = credentials(site), signed(site)
    await revoke(site, witness, site.identity(EVE).thumbprint)
    heard = await send_header(witness.topic_port, eve, fields_for(EVE, TOPIC, [grant]))
    expect_refused(heard, caplog, Revoked, "revoked")
    answer = await call(witness.robot.uri, eve, "requestTopic", EVE, TOPIC, [["TCPROS"]])
    assert isinstance(answer, list)
    assert (answer[0], answer[1].endswith("is revoked"), answer[2]) == (-1, True, 0)
    assert isinstance(refusals(caplog)[-1], Revoked)
    assert site.master is not None
    with pytest.raises(RossecError):
        await call(site.master.uri, eve, "getUri", EVE)
    told = await call(site.master.uri, eve, "rossec.revocations", EVE)
    assert isinstance(told, list)
    assert told[2][1] == b"", "what it is told must not let it go on"
    assert not [record for record in caplog.records if record.exc_info], "a crash was logged"


@pytest.mark.attack("outlived-right")
@pytest.mark.parametrize("name", [EVE, MASTER])
async def test_the_slave_api_refuses_a_peer_revoked_while_connected(site: Site, name: str) -> None:
    """Also for the master: a stolen master key must not control nodes."""
    async with site.node("/robot") as robot:
        client = RpcClient(await dial(robot.uri, credentials(site, name)))
        assert await client.ask("requestTopic", name, TOPIC, [["TCPROS"]])
        data = site.revoke(site.identity(name).thumbprint)
        with pytest.raises(CAError):  # the timestamp is invalid; the list counts nevertheless
            robot.push_arrived(REVOCATION_UPDATE, (data, b""), site.identity(MASTER))
        with pytest.raises(RossecError):  # the connection is cut,
            await client.call("shutdown", name, "now")
        client = RpcClient(await dial(robot.uri, credentials(site, name)))  # and a new one is refused
        answer = await client.call("shutdown", name, "now")
        assert isinstance(answer, list)
        assert answer[0] == -1
        assert answer[1].endswith("is revoked")
        await client.close()
        assert not robot._ended.done()


@pytest.mark.attack("outlived-right")
async def test_the_connection_of_a_revoked_node_is_closed(site: Site, witness: Witness) -> None:
    own = unlimited(credentials(site), site.anchor.verify)
    eve = await connect(HOST, witness.topic_port, own)
    await eve.send(tcpros.encode(fields_for(EVE, TOPIC, [signed(site)])))
    await until(lambda: len(witness.publisher.links) == 2)
    await revoke(site, witness, site.identity(EVE).thumbprint)
    async with asyncio.timeout(30):
        await eve.wait_ended()
    await until(lambda: len(witness.publisher.links) == 1)


@pytest.mark.attack("foreign-authority")
async def test_a_peer_of_another_authority_is_refused_in_the_handshake(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    """It has the viewer's own name, certified by its own authority for the same domain."""
    other = Site(site.root.parent / "other", site.anchor.domain)
    intruder = credentials(other, "/viewer")
    grants = [site.subscribe("/viewer", TOPIC)]  # copied from the viewer's disk
    with pytest.raises(PeerRefused) as caught:
        await send_header(witness.topic_port, intruder, fields_for("/viewer", TOPIC, grants))
    assert str(caught.value).isprintable()
    refused = refusals(caplog)[-1]
    assert isinstance(refused, IdentityRefused)
    assert isinstance(refused.__cause__, ForeignCertificate)
    assert site.master is not None
    for uri in (witness.robot.uri, site.master.uri):
        with pytest.raises(PeerRefused):
            await call(uri, intruder, "requestTopic", "/viewer", TOPIC, [["TCPROS"]])
        assert isinstance(refusals(caplog)[-1].__cause__, ForeignCertificate)


@pytest.mark.attack("another-name")
async def test_a_name_that_is_not_the_certified_one_is_refused(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    """N6: Eve shows the viewer's grants and claims to be the viewer."""
    fields = fields_for("/viewer", TOPIC, site.enroll("/viewer").grants())
    heard = await send_header(witness.topic_port, credentials(site), fields)
    expect_refused(heard, caplog, ConnectionHeaderRefused, "/eve calls itself /viewer")


@pytest.mark.attack("no-grant")
async def test_a_header_without_caller_or_topic_is_refused(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    for missing in ("callerid", "topic"):
        fields = fields_for(EVE, TOPIC, [signed(site)])
        del fields[missing]
        heard = await send_header(witness.topic_port, credentials(site), fields)
        expect_refused(heard, caplog, ConnectionHeaderRefused, missing)


@pytest.mark.attack("unit-before-right")
async def test_units_before_authorization_are_limited_to_a_header(site: Site, witness: Witness) -> None:
    """A unit is buffered before it is checked."""
    own = unlimited(credentials(site), site.anchor.verify)
    await expect_no_room(await connect(HOST, witness.topic_port, own), 300_000)
    uri = f"http://{HOST}:{witness.robot._listener.slave_port}/"
    await expect_no_room(await dial(uri, credentials(site)), 3 * 1024 * 1024)
    await witness.goes_on()


@pytest.mark.attack("no-grant")
async def test_an_authorized_subscriber_needs_the_same_type(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    fields = fields_for(EVE, TOPIC, [signed(site)], md5sum="0" * 32)
    heard = await send_header(witness.topic_port, credentials(site), fields)
    expect_refused(heard, caplog, ConnectionHeaderRefused, "carries")


@pytest.mark.attack("existence-oracle")
@pytest.mark.parametrize("changes", [{}, {"md5sum": "0" * 32}, {"type": "std_msgs/String"}, {"probe": "1"}])
@pytest.mark.parametrize("topics", [[], ["/kitchen/door"]], ids=["no grant", "a grant elsewhere"])
async def test_without_a_grant_the_refusal_does_not_tell_what_exists(
    site: Site, witness: Witness, changes: dict[str, str], topics: list[str]
) -> None:
    grants = [signed(site, pattern=topic) for topic in topics]
    missing = TOPIC[:-1] + "x"
    answers = []
    for topic in (TOPIC, missing):
        fields = fields_for(EVE, topic, grants, **changes)
        heard = await send_header(witness.topic_port, credentials(site), fields)
        assert not heard.after
        answers.append({**heard.fields, "error": heard.error.replace(topic, "TOPIC").encode()})
    assert answers[0] == answers[1]
    assert set(answers[0]) == {"error"}
