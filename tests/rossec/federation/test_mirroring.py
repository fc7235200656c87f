from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from grants.decision import Reach
from grants.model import Permission, Right
from rossec.errors import AnswerMalformed, AnswerRefused
from rossec.federation import exchange
from rossec.federation.exchange import OwnMaster
from rossec.net.rpc.calls import RpcClient
from tests.support.masters import Master, masters
from tests.support.site import Site
from tests.support.witness import until


@pytest.fixture
async def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[list[Master]]:
    monkeypatch.setattr(exchange, "MIRRORED_EVERY", 0.1)
    async with masters(Site(tmp_path / "site"), "/master", "/master/kitchen") as found:
        yield found


async def set_param(master: Master, name: str, value: object) -> None:
    grant = master.site.grant("/setter", Right.PARAM_SET, "/**")
    async with master.caller("/setter") as client:
        await client.ask("rossec.presentGrants", "/setter", [grant])
        await client.ask("setParam", "/setter", name, value)


def mirrored(master: Master, name: str) -> object:
    return master.server.state.imports.mirrors.item(name)[1]


async def test_the_parameters_that_are_named_are_mirrored(pair: list[Master]) -> None:
    hall, kitchen = pair
    hall.site.grant("/master", Right.PARAM_GET, "/robot/**")
    await set_param(kitchen, "/robot/speed", 2.5)
    await set_param(kitchen, "/robot/arm/joints", [1, 2])
    await set_param(kitchen, "/secret/key", "x")
    hall.follow(kitchen.as_site("kitchen", "", "/robot/**", "/secret/**"))
    await until(lambda: mirrored(hall, "/remote/kitchen/robot/speed") == 2.5)
    assert mirrored(hall, "/remote/kitchen/robot/arm/joints") == [1, 2]
    assert mirrored(hall, "/remote/kitchen/secret/key") is None, "no grant"
    assert hall.state_of("kitchen")["mirrored"] == 2
    assert mirrored(kitchen, "/remote/kitchen/robot/speed") is None


async def test_nothing_is_mirrored_by_default_and_a_change_is_read(pair: list[Master]) -> None:
    hall, kitchen = pair
    hall.site.grant("/master", Right.PARAM_GET, "/robot/**")
    await set_param(kitchen, "/robot/speed", 1)
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.state_of("kitchen")["state"] == "following")
    assert mirrored(hall, "/remote/kitchen/robot/speed") is None
    assert hall.state_of("kitchen")["mirrored"] == 0


async def test_a_changed_value_is_read_with_the_next_answer(pair: list[Master]) -> None:
    hall, kitchen = pair
    hall.site.grant("/master", Right.PARAM_GET, "/robot/**")
    await set_param(kitchen, "/robot/speed", 1)
    hall.follow(kitchen.as_site("kitchen", "", "/robot/**"))
    await until(lambda: mirrored(hall, "/remote/kitchen/robot/speed") == 1)
    await set_param(kitchen, "/robot/speed", 2)
    await until(lambda: mirrored(hall, "/remote/kitchen/robot/speed") == 2, within=8)


async def test_what_was_mirrored_goes_with_the_site(pair: list[Master]) -> None:
    hall, kitchen = pair
    hall.site.grant("/master", Right.PARAM_GET, "/robot/**")
    await set_param(kitchen, "/robot/speed", 1)
    hall.follow(kitchen.as_site("kitchen", "", "/robot/**"))
    await until(lambda: mirrored(hall, "/remote/kitchen/robot/speed") == 1)
    hall.take_list(hall.site.revoke(hall.site.identity("/master/kitchen").thumbprint))
    await until(lambda: mirrored(hall, "/remote/kitchen/robot/speed") is None)


class OtherMaster(RpcClient):
    """A master that gives these answers, whatever it is asked."""

    def __init__(self, *answers: object) -> None:
        self.answers = list(answers)

    async def ask(self, method: str, *params: object) -> object:
        return self.answers.pop(0)

    async def call(self, method: str, *params: object) -> object:
        return self.answers.pop(0)


def own_of(master: Master) -> OwnMaster:
    server = master.server
    return OwnMaster(server.state, server.effects, server.context, server.mirror, server.drop_mirror)


@pytest.mark.parametrize(
    "answers", [(7,), (["/a"], 7), (["/a"], []), (["/a", "/a/b"], [[[1, "", 1]], [[1, "", 1]]])]
)
async def test_a_malformed_answer_is_an_error(pair: list[Master], answers: tuple[object, ...]) -> None:
    reading = exchange.Mirroring(own_of(pair[0]), pair[1].as_site("kitchen", "", "/**"))
    with pytest.raises(AnswerMalformed):
        await reading.keep(OtherMaster(*answers))


async def test_too_many_parameters_are_refused(pair: list[Master], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exchange, "MAX_NAMES", 1)
    reading = exchange.Mirroring(own_of(pair[0]), pair[1].as_site("kitchen", "", "/**"))
    with pytest.raises(AnswerRefused, match="has 2 parameters"):
        await reading.keep(OtherMaster(["/a", "/b"]))


async def test_another_list_of_domains_counts_at_once(
    pair: list[Master], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For what was mirrored, and for what was just being read."""
    own = own_of(pair[0])
    rules = {"h": Reach((Permission("/speed", Right.PARAM_GET),))}
    monkeypatch.setattr(own.state.trust.domains, "imported", rules.get)
    reading = exchange.Mirroring(own, pair[1].as_site("h", "h", "/**"))
    await reading.keep(OtherMaster(["/speed", "/key"], [[[1, "", 2]]]))
    reading.judge()
    assert mirrored(pair[0], "/remote/h/speed") == 2
    assert mirrored(pair[0], "/remote/h/key") is None
    rules["h"] = Reach(())
    reading.judge()
    assert mirrored(pair[0], "/remote/h/speed") is None
    assert reading.mirrored == 0
