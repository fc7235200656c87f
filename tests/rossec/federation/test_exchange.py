from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.revocation.lists import digest
from rossec.errors import AnswerMalformed, AnswerRefused
from rossec.federation import exchange
from rossec.federation.exchange import OwnMaster
from rossec.net.rpc.calls import RpcClient
from rossec.ros.xmlrpc import Fault
from tests.support.masters import Master, domain_list, masters
from tests.support.site import Site
from tests.support.witness import until

NAMES = "/master", "/master/kitchen", "/master/hall"
WITHIN = 3.0  # seconds; a second is promised, and these tests share a machine


@pytest.fixture
async def pair(tmp_path: Path) -> AsyncIterator[list[Master]]:
    async with masters(Site(tmp_path / "site"), *NAMES[:2]) as found:
        yield found


async def followed(by: Master, label: str) -> None:
    await until(lambda: by.state_of(label)["state"] == "following")


@pytest.mark.parametrize("at", [0, 1])
async def test_a_new_list_at_one_is_at_the_other_at_once(pair: list[Master], at: int) -> None:
    """Only one of them follows the other."""
    hall, kitchen = pair
    hall.follow(kitchen.as_site("kitchen"))
    await followed(hall, "kitchen")
    data = hall.site.revoke(hall.site.identity("/master").thumbprint[::-1])
    pair[at].take_list(data)
    await until(lambda: hall.list_number == kitchen.list_number == (1, 2), within=WITHIN)


@pytest.mark.parametrize("at", [0, 1])
async def test_a_master_with_an_older_list_gets_the_newest_when_they_meet(
    pair: list[Master], at: int
) -> None:
    hall, kitchen = pair
    pair[at].take_list(hall.site.revoke(b"k" * 32))
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.list_number == kitchen.list_number == (1, 2), within=WITHIN)
    await followed(hall, "kitchen")


@pytest.mark.parametrize("at", [0, 1])
async def test_trees_too(pair: list[Master], at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    hall, kitchen = pair
    hall.follow(kitchen.as_site("kitchen"))
    kitchen.follow(hall.as_site("hall"))
    await followed(hall, "kitchen")
    await followed(kitchen, "hall")
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    data = hall.site.revoke(b"k" * 32)
    entries = hall.site.entries
    assert entries is not None
    pair[at].take_tree(data, entries)
    await until(lambda: hall.list_number == kitchen.list_number == (1, 2), within=WITHIN)
    assert hall.server.state.trust.tree_entries == kitchen.server.state.trust.tree_entries


@pytest.mark.parametrize("at", [0, 1])
async def test_a_list_of_domains(pair: list[Master], at: int) -> None:
    hall, kitchen = pair
    hall.follow(kitchen.as_site("kitchen"))
    await followed(hall, "kitchen")
    data = domain_list(hall.site, *NAMES[:2], seq=2)
    pair[at].take_domains(data)
    held = [master.server.state.trust.domains.anchors for master in pair]
    await until(lambda: held[0].data == held[1].data == data, within=WITHIN)


async def test_a_list_reaches_every_master_of_a_chain(tmp_path: Path) -> None:
    async with masters(Site(tmp_path / "site"), *NAMES) as (first, second, third):
        first.follow(second.as_site("second"))
        second.follow(third.as_site("third"))
        await followed(first, "second")
        await followed(second, "third")
        third.take_list(first.site.revoke(b"k" * 32))
        await until(lambda: first.list_number == (1, 2), within=WITHIN)


async def test_a_revoked_master_is_followed_no_longer(pair: list[Master]) -> None:
    hall, kitchen = pair
    await kitchen.register("/robot", "/pose", 4711)
    hall.want()
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.imported("/pose"))
    hall.take_list(hall.site.revoke(hall.site.identity("/master/kitchen").thumbprint))
    await until(lambda: not hall.imported("/pose"), within=WITHIN)
    await until(lambda: "revoked" in hall.state_of("kitchen")["error"])


class FixedAnswers(RpcClient):
    """A master that gives these answers, whatever it is asked; `asked` are the methods."""

    def __init__(self, *answers: object) -> None:
        self.answers, self.asked = list(answers), list[str]()

    async def ask(self, method: str, *params: object) -> object:
        self.asked.append(method)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


def own_of(master: Master) -> OwnMaster:
    server = master.server
    return OwnMaster(server.state, server.effects, server.context, server.mirror, server.drop_mirror)


@pytest.mark.parametrize("answer", [7, [], [b"", ""], ["", b""], [b"", b"", b""]])
async def test_an_answer_without_a_list_is_an_error(pair: list[Master], answer: object) -> None:
    own, peer = own_of(pair[0]), pair[1].site.identity("/master/kitchen")
    with pytest.raises(AnswerMalformed):
        await exchange.settle_revocations(FixedAnswers(answer), own, peer)
    if not isinstance(answer, bytes):
        with pytest.raises(AnswerMalformed):
            await exchange.settle_domains(FixedAnswers(answer), own, peer)


async def test_a_list_that_is_no_list_is_answered_with_the_own_one(pair: list[Master]) -> None:
    own, peer = own_of(pair[0]), pair[1].site.identity("/master/kitchen")
    liar = FixedAnswers([b"garbage", b""], 1)
    await exchange.settle_revocations(liar, own, peer)
    assert liar.asked == ["rossec.revocationsSince", "rossec.updateRevocations"]
    liar = FixedAnswers(b"garbage", 1)
    await exchange.settle_domains(liar, own, peer)
    assert liar.asked == ["rossec.domains", "rossec.updateDomains"]
    assert own.state.trust.list_digests()[0] == digest(own.state.trust.list_data)


async def test_a_master_that_knows_no_lists_of_domains_gets_none(pair: list[Master]) -> None:
    own, peer = own_of(pair[0]), pair[1].site.identity("/master/kitchen")
    for error in (AnswerRefused("no"), Fault(1, "unknown method")):
        old = FixedAnswers(error)
        await exchange.settle_domains(old, own, peer)
        assert old.asked == ["rossec.domains"]


async def test_the_entries_of_a_tree_are_bytes(pair: list[Master], monkeypatch: pytest.MonkeyPatch) -> None:
    own, peer = own_of(pair[0]), pair[1].site.identity("/master/kitchen")
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    tree = pair[0].site.revoke(b"k" * 32)
    with pytest.raises(AnswerMalformed, match="entries of a tree"):
        await exchange.settle_revocations(FixedAnswers([tree, b""], 7), own, peer)
    assert pair[0].list_number == (1, 1)
