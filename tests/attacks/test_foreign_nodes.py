"""Nodes of other domains at a node: who is let in, by whose grants, and what ends it."""

from pathlib import Path
from typing import Any, Final

import pytest

from ca.errors import CAError, NotAdmitted, RevocationsStale, Revoked
from ca.revocation.lists import MAX_AGE, Timestamp, digest, open_list, sign_timestamp
from grants.errors import GrantError, GrantMissing
from grants.model import Right
from rossec.channel.edhoc.credentials import Credentials
from rossec.errors import IdentityRefused, PeerRefused
from rossec.home import NodeHome
from rossec.net.aio import SecureStream, connect
from rossec.net.rpc.calls import RpcClient
from rossec.ros import tcpros
from rossec.ros.names import MASTER
from tests.support import trust
from tests.support.attacker import (
    EVE,
    HOST,
    Reply,
    credentials,
    dial,
    fields_for,
    refusals,
    send_header,
    signed,
)
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.witness import TOPIC, Witness, until

DOMAIN: Final = "hospital"


class Visitor:
    """The home of the witness has listed a hospital, where Eve is enrolled."""

    def __init__(self, home: Site, hospital: Site, witness: Witness) -> None:
        self.home, self.hospital, self.witness = home, hospital, witness
        self.eve = credentials(hospital)

    async def list(self, data: bytes) -> None:
        """Publish a list of domains, until the nodes have it."""
        await self.witness.robot._membership.session.call("rossec.updateDomains", data)
        for node in (self.witness.robot, self.witness.viewer):
            await until(lambda node=node: node._membership._identity.anchors.data == data)  # type: ignore[misc]

    async def word(self, data: bytes, age: int = 0, site: Site | None = None) -> None:
        """Have the hospital's master say that `data` is its newest list; until the robot knows."""
        by = site or self.hospital
        signer = by.enroll(MASTER).credentials()
        seq = open_list(data, by.anchor.public_key).seq
        stamp = Timestamp(seq, digest(data), by.now() - age, MAX_AGE)
        assert self.home.master is not None
        self.home.master.effects.take_foreign(
            DOMAIN, data, sign_timestamp(signer.signer, stamp), signer.chain
        )
        await until(lambda: self.held == data)

    @property
    def held(self) -> bytes:
        found = self.witness.robot._membership._identity.trust_status.foreign(DOMAIN)
        return b"" if found is None else found.data

    @property
    def newest(self) -> bytes:
        found = self.hospital.authority.store.newest_list()
        assert found is not None
        return found

    def shared(self, right: Right = Right.SUBSCRIBE) -> bytes:
        """A grant of the home for Eve."""
        return trust.share(self.home, self.hospital, EVE, right, TOPIC)

    async def ask(self, *grants: bytes, eve: Credentials | None = None) -> Reply:
        fields = fields_for(EVE, TOPIC, list(grants))
        return await send_header(self.witness.topic_port, eve or self.eve, fields, 4096)

    async def stays(self, grant: bytes) -> SecureStream[Any]:
        """Eve receives the topic."""
        links = len(self.witness.publisher.links)
        own = unlimited(self.eve, self.home.anchor.verify)
        stream = await connect(HOST, self.witness.topic_port, own)
        await stream.send(tcpros.encode(fields_for(EVE, TOPIC, [grant])))
        await until(lambda: len(self.witness.publisher.links) == links + 1)
        return stream


@pytest.fixture
async def visit(site: Site, witness: Witness, tmp_path: Path) -> Visitor:
    visit = Visitor(site, Site(tmp_path / "hospital", DOMAIN), witness)
    await visit.list(trust.accept(site, visit.hospital))
    await visit.word(visit.newest)
    return visit


def refused(caplog: pytest.LogCaptureFixture, kind: type[Exception]) -> str:
    """The last refusal, or its cause."""
    found = refusals(caplog)[-1]
    error = found.__cause__ if isinstance(found, IdentityRefused) else found
    assert isinstance(error, kind), repr(error)
    return str(error)


@pytest.mark.attack("foreign-node")
async def test_a_listed_foreigner_reads_what_the_home_grants_and_nothing_else(
    visit: Visitor, caplog: pytest.LogCaptureFixture
) -> None:
    said = await visit.ask(visit.shared())
    assert said.fields["callerid"] == b"/robot"
    said = await visit.ask()
    assert "no grant for subscribe" in said.error
    refused(caplog, GrantMissing)


@pytest.mark.attack("foreign-node")
@pytest.mark.parametrize("how", ["unlisted", "removed", "not admitted"])
async def test_a_foreigner_without_trust_is_refused_in_the_handshake(
    visit: Visitor, how: str, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    eve, grant = visit.eve, visit.shared()
    match how:
        case "unlisted":
            eve = credentials(Site(tmp_path / "clinic", "clinic"))
        case "removed":
            await visit.list(trust.remove(visit.home, DOMAIN))
        case _:
            trust.remove(visit.home, DOMAIN)
            await visit.list(trust.accept(visit.home, visit.hospital, "other", admitted=("/rounds/*",)))
    with pytest.raises(PeerRefused):
        await visit.ask(grant, eve=eve)
    refused(caplog, CAError)


@pytest.mark.attack("foreign-node")
async def test_the_trust_that_ended_admits_nobody(visit: Visitor, caplog: pytest.LogCaptureFixture) -> None:
    grant = visit.shared()
    trust.remove(visit.home, DOMAIN)
    await visit.list(trust.accept(visit.home, visit.hospital, "other", lifetime=1))
    await until(lambda: visit.witness.robot._membership._identity.anchors.ended(visit.home.now()))
    with pytest.raises(PeerRefused):
        await visit.ask(grant)
    assert "has ended" in refused(caplog, NotAdmitted)


@pytest.mark.attack("foreign-node")
async def test_another_authority_with_the_hospitals_name_is_refused(
    visit: Visitor, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    """Its own root, the same domain: the list says which key is the hospital's."""
    forger = credentials(Site(tmp_path / "forger", DOMAIN))
    with pytest.raises(PeerRefused):
        await visit.ask(visit.shared(), eve=forger)
    assert "not signed by the authority" in refused(caplog, CAError)


@pytest.mark.attack("foreign-node")
async def test_the_hospitals_root_certifies_nobody_of_the_home(
    visit: Visitor, caplog: pytest.LogCaptureFixture
) -> None:
    """A certificate for a name of the home, signed by the hospital's key."""
    stolen = Site(visit.hospital.root.parent / "twin", "home")
    with pytest.raises(PeerRefused):
        await visit.ask(eve=credentials(stolen, "/viewer"))
    assert "not signed by the authority of trust domain 'home'" in refused(caplog, CAError)


@pytest.mark.attack("foreign-node")
async def test_a_foreigner_is_refused_while_nothing_fresh_is_known(
    visit: Visitor, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    clinic = Site(tmp_path / "clinic", "clinic")
    await visit.list(trust.accept(visit.home, clinic))
    said = await visit.ask(eve=credentials(clinic))
    assert "of domain clinic" in said.error
    refused(caplog, RevocationsStale)


@pytest.mark.attack("foreign-node")
async def test_old_lists_of_the_hospital_are_played_back(visit: Visitor) -> None:
    """By its own master: what was revoked stays so, and nothing is confirmed by it."""
    old = visit.newest
    await visit.word(visit.hospital.revoke(visit.hospital.identity(EVE).thumbprint))
    with pytest.raises(CAError, match="is older than"):
        await visit.word(old)
    signer = visit.hospital.enroll(MASTER).credentials()
    stamp = sign_timestamp(signer.signer, Timestamp(1, digest(old), visit.home.now(), MAX_AGE))
    robot, master = visit.witness.robot, visit.home.identity(MASTER)
    with pytest.raises(CAError):
        robot.push_arrived("rossec.foreignRevocationUpdate", (DOMAIN, old, stamp, list(signer.chain)), master)
    said = await visit.ask(visit.shared())
    assert "is revoked" in said.error


@pytest.mark.attack("foreign-node")
async def test_a_list_confirmed_under_another_root_counts_for_nothing(visit: Visitor, tmp_path: Path) -> None:
    forger = Site(tmp_path / "forger", DOMAIN)
    robot, master = visit.witness.robot, visit.home.identity(MASTER)
    data = forger.revoke(visit.hospital.identity(EVE).thumbprint)
    theirs = visit.hospital.revoke(bytes(32))
    for signer, site, said in (
        (forger.enroll(MASTER), forger, data),
        (forger.enroll(MASTER), forger, theirs),
        (visit.home.enroll(MASTER), visit.home, theirs),
        (visit.hospital.enroll("/rounds"), visit.hospital, theirs),
    ):
        own: NodeHome = signer
        stamp = sign_timestamp(own.credentials().signer, Timestamp(2, digest(said), site.now(), MAX_AGE))
        word = (DOMAIN, said, stamp, list(own.credentials().chain))
        with pytest.raises(CAError):
            robot.push_arrived("rossec.foreignRevocationUpdate", word, master)
    assert visit.witness.robot.revocations.entries == frozenset()
    assert robot._membership._identity.trust_status.revoked(DOMAIN) == {bytes(32)}


@pytest.mark.attack("foreign-grants")
@pytest.mark.parametrize("domain", [DOMAIN, "home"])
async def test_a_grant_that_the_hospital_signed_opens_nothing_of_the_home(
    visit: Visitor, domain: str, caplog: pytest.LogCaptureFixture
) -> None:
    grant = signed(
        visit.hospital,
        pattern="/**",
        right=Right.SUBSCRIBE,
        domain=domain,
        holder=visit.hospital.identity(EVE).thumbprint,
    )
    said = await visit.ask(grant)
    assert said.error
    refused(caplog, GrantError)


@pytest.mark.attack("foreign-grants")
async def test_a_grant_of_the_home_for_the_other_domain_opens_nothing(
    visit: Visitor, caplog: pytest.LogCaptureFixture
) -> None:
    """Signed by the right key; `aud` says that it is about the hospital's names."""
    grant = signed(visit.home, domain=DOMAIN, holder=visit.hospital.identity(EVE).thumbprint)
    assert (await visit.ask(grant)).error
    refused(caplog, GrantError)


@pytest.mark.attack("foreign-names")
async def test_the_viewer_of_the_hospital_is_not_ours(
    visit: Visitor, caplog: pytest.LogCaptureFixture
) -> None:
    """Same name, another domain: with the grants from our viewer's disk."""
    twin, ours = credentials(visit.hospital, "/viewer"), visit.home.enroll("/viewer").grants()
    fields = fields_for("/viewer", TOPIC, ours)
    said = await send_header(visit.witness.topic_port, twin, fields)
    assert "bound to another key" in said.error
    refused(caplog, GrantError)


@pytest.mark.attack("foreign-names")
@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("shutdown", ("now",)),
        ("publisherUpdate", (TOPIC, [])),
        ("rossec.revocationUpdate", (b"", b"")),
        ("rossec.domainsUpdate", (b"",)),
        ("rossec.foreignRevocationUpdate", (DOMAIN, b"", b"", [])),
        ("getPid", ()),
    ],
)
async def test_the_master_of_the_hospital_controls_no_node_of_the_home(
    visit: Visitor, method: str, params: tuple[object, ...]
) -> None:
    master = credentials(visit.hospital, MASTER)
    client = RpcClient(await dial(visit.witness.robot.uri, master))
    answer: Any = await client.call(method, MASTER, *params)
    assert answer[:2] == [-1, f"rossec: {method} is for the master alone"]
    await client.close()
    assert not visit.witness.robot._ended.done()


@pytest.mark.attack("foreign-node")
@pytest.mark.parametrize("by", ["hospital", "home", "removal", "grant"])
async def test_what_stands_is_cut_within_a_second(visit: Visitor, by: str) -> None:
    grant = visit.shared()
    stream = await visit.stays(grant)
    began = visit.home._clock()
    key = visit.hospital.identity(EVE).thumbprint
    session = visit.witness.robot._membership.session
    match by:
        case "hospital":
            await visit.word(visit.hospital.revoke(key))
        case "home":
            await session.call("rossec.updateRevocations", visit.home.revoke(key))
        case "removal":
            await visit.list(trust.remove(visit.home, DOMAIN))
        case _:
            await session.call("rossec.updateRevocations", visit.home.revoke(grant))
    await until(lambda: len(visit.witness.publisher.links) == 1)
    assert visit.home._clock() - began < 2
    stream.abort("it is over")


@pytest.mark.attack("foreign-node")
async def test_a_forged_or_old_list_of_domains_admits_nobody(visit: Visitor, tmp_path: Path) -> None:
    """Pushed by the own master, whose key was stolen: it signs no list."""
    robot, master = visit.witness.robot, visit.home.identity(MASTER)
    old = robot._membership._identity.anchors.data
    clinic = Site(tmp_path / "clinic", "clinic")
    forged = trust.accept(Site(tmp_path / "forger", "home"), clinic)
    await visit.list(trust.remove(visit.home, DOMAIN))
    for data in (forged, old, b"", b"garbage"):
        with pytest.raises(CAError):
            robot.push_arrived("rossec.domainsUpdate", (data,), master)
    assert robot._membership._identity.anchors.all_listed == ()
    for eve in (credentials(clinic), visit.eve):
        with pytest.raises(PeerRefused):
            await visit.ask(eve=eve)


@pytest.mark.attack("foreign-node")
async def test_a_revoked_key_of_the_hospital_is_refused_by_either_list(
    visit: Visitor, caplog: pytest.LogCaptureFixture
) -> None:
    await visit.word(visit.hospital.revoke(visit.hospital.identity(EVE).thumbprint))
    assert "is revoked" in (await visit.ask(visit.shared())).error
    refused(caplog, Revoked)
