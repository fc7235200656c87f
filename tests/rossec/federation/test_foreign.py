import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from ca.domains import ForeignDomain, NameRights
from grants.model import Right
from rossec.errors import AnswerMalformed, SiteRefused
from rossec.federation import exchange
from rossec.federation.exchange import APART, OwnMaster
from rossec.federation.settings import SiteSettings
from rossec.master.server.effects import Effects
from rossec.net.rpc.calls import RpcClient
from tests.support.masters import Master, domain_list, masters
from tests.support.site import DAY, Site
from tests.support.witness import until


def trusting(site: Site, label: str, *taken: NameRights) -> ForeignDomain:
    """What another domain says of `site`; without `taken` everything is."""
    end = int(time.time()) + DAY
    return ForeignDomain(
        site.anchor.domain,
        label,
        site.anchor.certificate,
        ("/rounds/*", "/master"),
        3600,
        end,
        imported=tuple((pattern, int(rights)) for pattern, rights in taken) or None,
    )


def take(pair: list[Master], seq: int, *taken: NameRights) -> None:
    """A list of domains that takes only this from the hospital."""
    here, there = pair
    listed = [trusting(there.site, "h", *taken)]
    here.take_domains(domain_list(here.site, "/master", foreign=listed, seq=seq))


def install_graph(to: Master, of: Master) -> None:
    """A grant with which one master may see the graph of the other."""
    key = to.site.identity("/master").thumbprint
    data = of.site.grant("/robot", Right.GRAPH, "/master", holder=key)
    to.home.add_grant(data[-16:], data)


@pytest.fixture
async def pair(tmp_path: Path) -> AsyncIterator[list[Master]]:
    """Home follows the hospital's master; each trusts the other domain, grants are given."""
    home, hospital = Site(tmp_path / "home", "home"), Site(tmp_path / "hospital", "hospital")
    async with AsyncExitStack() as stack:
        (here,) = await stack.enter_async_context(masters(home, "/master"))
        (there,) = await stack.enter_async_context(masters(hospital, "/master"))
        here.take_domains(domain_list(home, "/master", foreign=[trusting(hospital, "h")], seq=2))
        there.take_domains(domain_list(hospital, "/master", foreign=[trusting(home, "h1")], seq=2))
        for pattern in ("/master", "/rounds/pose", "/rounds/map"):
            data = hospital.grant("/robot", Right.GRAPH, pattern, holder=home.identity("/master").thumbprint)
            here.home.add_grant(data[-16:], data)
        here.want()
        there.follow(here.as_site("h1", "h1"))  # without a grant: it hears what is revoked
        yield [here, there]


async def test_what_a_foreign_master_shows_lies_below_remote(pair: list[Master]) -> None:
    here, there = pair
    await there.register("/rounds/robot3", "/rounds/pose", 4711)
    await there.register("/nurse", "/secret", 4712)
    here.follow(there.as_site("h", "h"))
    await until(lambda: here.imported("/remote/h/rounds/pose"))
    assert here.imported("/rounds/pose") == here.imported("/remote/h/secret") == []
    assert here.state_of("h")["error"] == ""
    assert "h1 refuses" in there.state_of("h1")["error"]


async def test_only_what_is_taken_from_it_comes_and_another_list_counts_at_once(pair: list[Master]) -> None:
    here, there = pair
    pose, a_map = "/remote/h/rounds/pose", "/remote/h/rounds/map"
    await there.register("/rounds/robot3", "/rounds/pose", 4711)
    await there.register("/rounds/robot4", "/rounds/map", 4712)

    take(pair, 3, ("/rounds/pose", Right.SUBSCRIBE))
    here.follow(there.as_site("h", "h"))
    await until(lambda: here.imported(pose))
    assert here.imported(a_map) == []
    take(pair, 4, ("/rounds/map", Right.SUBSCRIBE | Right.GRAPH))
    assert (here.imported(pose), bool(here.imported(a_map))) == ([], True)
    take(pair, 5)
    assert here.imported(pose)
    assert here.imported(a_map)


async def test_parameters_are_mirrored_as_far_as_they_are_taken(
    pair: list[Master], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exchange, "MIRRORED_EVERY", 0.1)
    here, there = pair
    key = here.site.identity("/master").thumbprint
    for name in ("/rounds/speed", "/rounds/key"):
        data = there.site.grant("/robot", Right.PARAM_GET, name, holder=key)
        here.home.add_grant(data[-16:], data)
        grant = there.site.grant("/setter", Right.PARAM_SET, name)
        async with there.caller("/setter") as client:
            await client.ask("rossec.presentGrants", "/setter", [grant])
            await client.ask("setParam", "/setter", name, 1)

    def mirrored() -> list[object]:
        mirrors = here.server.state.imports.mirrors
        return [mirrors.item(f"/remote/h/rounds/{name}")[1] for name in ("speed", "key")]

    take(pair, 3, ("/rounds/speed", Right.PARAM_GET), ("/rounds/key", Right.SUBSCRIBE))
    here.follow(there.as_site("h", "h", "/rounds/**"))
    await until(lambda: mirrored() == [1, None])
    take(pair, 4, ("/rounds/key", Right.PARAM_GET))
    await until(lambda: mirrored()[0] is None, within=1)
    await until(lambda: mirrored() == [None, 1], within=8)


async def test_its_revocations_are_fetched_at_once(pair: list[Master]) -> None:
    here, there = pair
    here.follow(there.as_site("h", "h"))
    await until(lambda: here.state_of("h")["state"] == "following")
    domains = here.server.state.trust.domains
    word = domains.word("hospital")
    assert word.timestamp
    assert word.chain == there.home.credentials().chain
    key = there.site.identity("/rounds/robot3").thumbprint
    there.take_list(there.site.revoke(key))
    await until(lambda: key in domains.trust_status.revoked("hospital"), within=3)


async def test_lists_in_a_row_are_taken_one_each_second(
    pair: list[Master], monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = pair
    taken: list[float] = []
    take = Effects.take_foreign

    def noted(effects: Effects, domain: str, revocations: bytes, *rest: Any) -> None:
        if revocations and effects is here.server.effects:
            taken.append(time.monotonic())
        take(effects, domain, revocations, *rest)

    here.follow(there.as_site("h", "h"))
    await until(lambda: here.state_of("h")["state"] == "following")
    monkeypatch.setattr(Effects, "take_foreign", noted)
    domains, began = here.server.state.trust.domains, time.monotonic()
    for number in range(8):
        there.take_list(there.site.revoke(bytes([number]) * 32))
        await asyncio.sleep(0.2)
    await until(lambda: len(domains.trust_status.revoked("hospital")) == 8, within=3)
    assert taken[0] - began < APART, "the first one at once"
    assert all(later - sooner > APART * 0.9 for sooner, later in pairwise(taken))


async def test_a_domain_that_is_removed_is_followed_no_longer(pair: list[Master]) -> None:
    here, there = pair
    await there.register("/rounds/robot3", "/rounds/pose", 4711)
    here.follow(there.as_site("h", "h"))
    await until(lambda: here.imported("/remote/h/rounds/pose"))
    here.take_domains(domain_list(here.site, "/master", seq=3))
    await until(lambda: not here.imported("/remote/h/rounds/pose"), within=3)
    await until(lambda: here.mesh.status()["problems"])
    assert "h is not a domain that is trusted" in str(here.mesh.status()["problems"])


async def test_a_master_that_shows_nothing_is_asked_once_and_heard(
    pair: list[Master], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(exchange, "LONGEST_FOREIGN", 0.2)
    here, there = pair
    await here.register("/rounds/robot3", "/rounds/pose", 4711)
    there.want()
    await until(lambda: there.state_of("h1")["state"] == "listening")
    assert "needs the right graph" in there.state_of("h1")["error"]
    key = here.site.identity("/rounds/robot3").thumbprint
    here.take_list(here.site.revoke(key))
    revoked = there.server.state.trust.domains.trust_status.revoked
    await until(lambda: key in revoked("home"), within=3)
    assert there.state_of("h1")["state"] == "listening"
    for name in ("rossec.federation", "rossec.audit", "rossec.audit.denials"):
        assert [each.name for each in caplog.records].count(name) == 1, name
    here.follow(there.as_site("h", "h"))  # before it knows what the hospital revokes no grant counts
    await until(lambda: here.state_of("h")["state"] == "following")
    install_graph(there, here)
    await until(lambda: there.state_of("h1")["state"] == "following")
    assert there.state_of("h1")["error"] == ""


async def test_listening_ends_with_the_trust(pair: list[Master]) -> None:
    _, there = pair
    await until(lambda: there.state_of("h1")["state"] == "listening")
    there.take_domains(domain_list(there.site, "/master", seq=3))
    await until(lambda: there.mesh.status()["problems"])


async def test_the_own_domain_is_not_taken_for_a_foreign_one(pair: list[Master]) -> None:
    here, there = pair
    here.follow(SiteSettings("kitchen", there.server.uri, "/master/kitchen"))
    await until(lambda: here.state_of("kitchen")["error"])
    assert "h:/master answers at" in here.state_of("kitchen")["error"]


async def test_who_is_refused_without_a_reason_is_told_what_to_ask(pair: list[Master]) -> None:
    here, there = pair
    there.take_domains(domain_list(there.site, "/master", seq=3))
    here.follow(there.as_site("h", "h"))
    await until(lambda: here.state_of("h")["error"])
    assert "does h trust this domain?" in here.state_of("h")["hint"]


async def test_proofs_of_its_tree_are_fetched(pair: list[Master], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exchange, "FOREIGN_EVERY", 0.1)
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    here, there = pair
    here.follow(there.as_site("h", "h"))
    await until(lambda: here.state_of("h")["state"] == "following")
    revoked, valid = there.site.identity("/rounds/robot3").thumbprint, b"k" * 32
    tree, entries = there.site.revoke(revoked), there.site.entries
    assert entries is not None
    there.take_tree(tree, entries)
    domains = here.server.state.trust.domains
    await until(lambda: domains.word("hospital").revocations == tree, within=3)
    assert domains.proofs("hospital", [revoked, valid]) == [b"", b""]
    here.want("/asked")  # the next answer comes at once
    await until(lambda: all(domains.proofs("hospital", [revoked, valid])), within=8)
    assert revoked in domains.trust_status.revoked("hospital")
    assert valid not in domains.trust_status.revoked("hospital")


class OtherMaster(RpcClient):
    """A master that gives this answer, whatever it is asked."""

    def __init__(self, answer: object) -> None:
        self.answer = answer

    async def ask(self, method: str, *params: object) -> object:
        return self.answer


@pytest.mark.parametrize("answer", [7, [], [b"", ""], [b"", b"", b""]])
async def test_an_answer_without_revocations_is_an_error(pair: list[Master], answer: object) -> None:
    here, there = pair
    peer, lists = there.site.identity("/master"), exchange.ForeignLists(own_of(here), "h")
    with pytest.raises(AnswerMalformed):
        await lists.greet(OtherMaster(answer), peer)


async def test_nothing_is_asked_for_a_domain_that_is_not_listed(pair: list[Master]) -> None:
    here, there = pair
    peer, lists = there.site.identity("/master"), exchange.ForeignLists(own_of(here), "clinic")
    with pytest.raises(SiteRefused, match="not a domain that is trusted"):
        await lists.keep_fresh(OtherMaster([b"", b""]), peer, b"")


def own_of(master: Master) -> OwnMaster:
    server = master.server
    return OwnMaster(server.state, server.effects, server.context, server.mirror, server.drop_mirror)
