"""Mallory claims to be another, by metadata at a join.

She has the code of an invitation, or owns the network or the process at the join port.
"""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import cast

import pytest

from ca.enrollment.invitation import InvitationCode, JoinClaim, JoinRequest
from ca.enrollment.join import (
    AuthorityJoin,
    Issued,
    Join,
    JoinAnswer,
    JoinMessage,
    NameAnswer,
    Named,
    NodeJoin,
    RefusedMessage,
    RefuseReason,
    read,
    write,
)
from ca.enrollment.messages import frame, length
from ca.errors import HintedError, JoinRefused
from grants.errors import PolicyRefused
from grants.policy.read import load
from rossec.authority import invitations
from rossec.authority.keyservice import network
from rossec.authority.keyservice.network import JoinNames, NetworkWork
from rossec.authority.keyservice.process import FrontEndProcess
from rossec.clock import now
from rossec.enrollment import join
from rossec.enrollment.join import JoinServer
from rossec.naming import rule_runner
from tests.grants.policy.policies import nothing_known
from tests.rossec.authority.keyservice.test_network import PlayedFace
from tests.rossec.authority.keyservice.test_work import Working
from tests.rossec.namespace.test_topic_names import BOMB, SLOW
from tests.rossec.naming.stylesheets import gives
from tests.support.joining import JoinSite, asked, fresh
from tests.support.pki import NOW
from tests.support.witness import until

Change = Callable[[JoinMessage], JoinMessage]
LAMP = b"<node><group>fleet</group><name>lamp</name></node>"
RULES = rule_runner.shipped_rules()
TO_THE_LETTER = gives("//name")  # rules of somebody careless: the name is what the node says


def clock() -> int:
    return NOW


class Authority:
    """An authority in memory that names nodes: it decides each request as the service does."""

    def __init__(self, home: JoinSite, names: JoinNames) -> None:
        self.home, self.names = home, names
        self.requests: list[JoinRequest] = []

    async def name(self, request: JoinClaim | JoinRequest) -> NameAnswer:
        pattern = invitations.allowed_pattern(self.home.store, request, NOW)
        if isinstance(pattern, RefusedMessage):
            return pattern
        return await self.names.answer(request.metadata, pattern)

    async def admit(self, request: JoinRequest) -> JoinAnswer:
        self.requests.append(request)
        if request.metadata:
            named = await self.name(request)
            if named != Named(request.name):
                return named if isinstance(named, RefusedMessage) else RefusedMessage(RefuseReason.NAME)
        return await self.home.admit(request)


@pytest.fixture
def home(tmp_path: Path) -> JoinSite:
    return JoinSite(tmp_path / "site")


@asynccontextmanager
async def serving(home: JoinSite, rules: bytes | None = RULES) -> AsyncIterator[Authority]:
    async with JoinNames(rules) as names:
        authority = Authority(home, names)
        server = JoinServer(home.identity, authority.admit, name=authority.name)
        async with home.serving(server):
            yield authority


async def joins(home: JoinSite, pattern: str, metadata: bytes) -> str:
    """A node that does as it should; the name it gets."""
    code = home.invite(pattern)
    name = await join.ask_name(code, metadata, clock)
    await join.join(code, lambda _: asked(name), clock, metadata)
    return name


@pytest.mark.attack("claimed-name")
async def test_metadata_of_a_node_that_exists_wait_for_a_person(home: JoinSite) -> None:
    async with serving(home):
        assert await joins(home, "/fleet/*", LAMP) == "/fleet/lamp"
        code = home.invite("/fleet/*")
        assert await join.ask_name(code, LAMP, clock) == "/fleet/lamp"
        with pytest.raises(HintedError, match="a person has to approve"):
            await join.join(code, lambda _: asked("/fleet/lamp"), clock, LAMP)


@pytest.mark.attack("claimed-name")
@pytest.mark.parametrize(
    "name",
    [
        "/ca",
        "/master",
        "/master/two",
        "/relay",
        "/remote/x/robot",
        "/gateway",
        "/../ca",
        "/fleet/lamp\n/ca",
        "/*",
        "/fleet/*",
        "",
    ],
)
async def test_reserved_names_and_what_is_none_are_not_given(home: JoinSite, name: str) -> None:
    async with serving(home, TO_THE_LETTER) as authority:
        for pattern in ("/**", "/*"):
            with pytest.raises(JoinRefused, match="no name for these metadata"):
                await joins(home, pattern, f"<node><name>{name}</name></node>".encode())
    assert authority.requests == []


@pytest.mark.attack("claimed-name")
async def test_a_name_outside_of_the_invitation_is_not_given(home: JoinSite) -> None:
    async with serving(home) as authority:
        for pattern in ("/doors/*", "/fleet/lamp2", "/*"):
            with pytest.raises(JoinRefused, match="or one that the invitation does not allow"):
                await joins(home, pattern, LAMP)
    assert authority.requests == []


@pytest.mark.attack("claimed-name")
async def test_another_name_than_that_of_the_metadata_is_not_issued(home: JoinSite) -> None:
    """She skips the claim, or asks for one name and then for another, within the pattern."""
    async with serving(home):
        code = home.invite()
        with pytest.raises(JoinRefused, match="another name"):
            await join.join(code, lambda _: asked("/fleet/door"), clock, LAMP)
    assert not home.store.identities.by_name("/fleet/door")
    assert not home.store.invitations.uses(code.id)


@pytest.mark.attack("claimed-name")
async def test_an_authority_without_rules_looks_at_no_metadata(
    home: JoinSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(network, "RuleRunner", None)  # there is nothing that could look
    async with serving(home, None):
        with pytest.raises(JoinRefused, match="has no rules that give names"):
            await joins(home, "/fleet/*", LAMP)
        code = home.invite()
        with pytest.raises(JoinRefused, match="has no rules that give names"):
            await join.join(code, lambda _: asked("/fleet/lamp"), clock, LAMP)
    assert not home.store.identities.by_name("/fleet/lamp")


@pytest.mark.attack("claimed-name")
async def test_a_stranger_s_metadata_reach_no_rules(home: JoinSite) -> None:
    """Without the secret of an invitation; what she sends is hashed, and nothing else."""
    reached: list[bytes] = []

    class Watched(JoinNames):
        async def answer(self, metadata: bytes, pattern: str) -> NameAnswer:
            reached.append(metadata)
            return await super().answer(metadata, pattern)

    async with Watched(RULES) as names:
        authority = Authority(home, names)
        code = home.invite()
        claim = _claim(home, code, LAMP)
        for forged in (
            JoinClaim(claim.invitation, claim.transcript, b"<node/>", claim.proof),
            JoinClaim(bytes(32), claim.transcript, LAMP, claim.proof),
            JoinClaim(claim.invitation, bytes(32), LAMP, claim.proof),
        ):
            assert await authority.name(forged) == RefusedMessage(RefuseReason.REFUSED)
        assert reached == []
        assert await authority.name(claim) == Named("/fleet/lamp")


def _claim(home: JoinSite, code: InvitationCode, metadata: bytes) -> JoinClaim:
    node, face = NodeJoin(code, fresh()), AuthorityJoin(home.identity(), fresh())
    welcome = face.receive(node.hello())
    assert welcome is not None
    node.receive(welcome, NOW)
    face.receive(node.claim(metadata))
    return face.claim


@asynccontextmanager
async def between(home: JoinSite, change: Change) -> AsyncIterator[None]:
    """Mallory on the way, or as the process at the port: `change` sees each message."""

    async def call(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, back = await asyncio.open_connection(*behind.split(":"))
        await asyncio.gather(carry(reader, back), carry(there, writer))

    async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(EOFError, OSError):
            while True:
                data = await reader.readexactly(length(await reader.readexactly(4)))
                writer.write(frame(write(change(read(data)))))
        writer.close()

    async with serving(home):
        behind = home.address
        front = await asyncio.start_server(call, "127.0.0.1", 0)
        async with front:
            home.address = f"127.0.0.1:{front.sockets[0].getsockname()[1]}"
            yield


@pytest.mark.attack("claimed-name")
async def test_a_name_that_was_changed_on_the_way_is_not_issued(home: JoinSite) -> None:
    def change(message: JoinMessage) -> JoinMessage:
        return Named("/fleet/door") if isinstance(message, Named) else message

    await _refused_between(home, change, "another name")


@pytest.mark.attack("claimed-name")
async def test_metadata_cannot_be_taken_out_or_exchanged_on_the_way(home: JoinSite) -> None:
    def without(message: JoinMessage) -> JoinMessage:
        if isinstance(message, Join):
            return Join(message.name, message.csr, message.proof)
        return Named("/fleet/door") if isinstance(message, Named) else message

    def other(message: JoinMessage) -> JoinMessage:
        if isinstance(message, Join):
            forwarded_port = LAMP.replace(b"lamp", b"forwarded_port")
            return Join(message.name, message.csr, message.proof, forwarded_port)
        return Named("/fleet/door") if isinstance(message, Named) else message

    for change in (without, other):
        await _refused_between(home, change, "does not know this invitation")


async def _refused_between(home: JoinSite, change: Change, error: str) -> None:
    async with between(home, change):
        code = home.invite()
        name = await join.ask_name(code, LAMP, clock)
        assert name == "/fleet/door", "the node cannot know better"
        with pytest.raises(JoinRefused, match=error):
            await join.join(code, lambda _: asked(name), clock, LAMP)
    assert not home.store.identities.by_name(name)
    assert not home.store.invitations.uses(code.id)


@pytest.mark.attack("claimed-name")
@pytest.mark.parametrize("claim", ["group: fleet", "owner: ann", "metadata: {group: fleet}"])
def test_a_policy_has_no_word_for_what_a_node_says_of_itself(claim: str) -> None:
    """So nothing can be granted to a claim, also by mistake: groups are patterns of names."""
    text = f"""rossec: 1
robot: r
identities:
  lamps: {{node: /fleet/*, {claim}}}
rules:
  - {{id: a, who: lamps, allow: {{subscribe: [/pose]}}}}
"""
    with pytest.raises(PolicyRefused, match=claim.split(":", maxsplit=1)[0]):
        load(text, nothing_known)


@pytest.mark.attack("claimed-name")
async def test_slow_metadata_keep_no_other_node_from_joining(tmp_path: Path) -> None:
    """Joins are decided in a thread, rules in processes: the one does not wait for the other."""
    working, face = Working(tmp_path, now()), PlayedFace()
    network = NetworkWork(tmp_path, working.operations, cast("FrontEndProcess", face), rules=SLOW)
    code = working.invite(uses=2)
    running = asyncio.ensure_future(network.run())
    try:
        await until(lambda: hasattr(face, "name"), within=40)
        slow = [asyncio.ensure_future(face.name(working.claim(code, BOMB.encode()))) for _ in range(8)]
        face.joins.put_nowait(working.request(code))
        async with asyncio.timeout(40):
            assert isinstance(read(cast("bytes", await face.answers.get())), Issued)
            for answer in await asyncio.gather(*slow):
                assert read(cast("bytes", answer)) == RefusedMessage(RefuseReason.METADATA)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
