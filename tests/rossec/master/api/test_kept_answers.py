"""What is kept of answers, for whom, and how much of it."""

from dataclasses import replace

import pytest

from grants.decision import Reach
from grants.model import Permission, Right
from rossec.master.api import kept_answers
from rossec.master.api.kept_answers import KeptAnswers
from rossec.master.api.methods import MasterTables
from rossec.master.rights.access_rules import RULES
from rossec.master.rights.caller import Caller
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import caller, master_api
from tests.rossec.master.rights.trust_world import World

NOW = 100
A = caller("/a", {"/**": Right(255)})


@pytest.fixture
def tables() -> MasterTables:
    return MasterTables("/master", World().trust, Imports(Registry()))


@pytest.fixture
def kept(tables: MasterTables) -> KeptAnswers:
    return KeptAnswers(tables)


def find(kept: KeptAnswers, who: Caller, now: int = NOW, call: bytes = b"call") -> bytes | None:
    return kept.find(who.thumbprint, call, lambda: (who, now))


def test_the_same_caller_finds_it_within_the_second(kept: KeptAnswers) -> None:
    kept.keep(A, NOW, b"call", b"answer")
    assert find(kept, A) == b"answer"
    assert find(kept, A, call=b"another") is None
    assert find(kept, replace(A)) is None, "its rights were evaluated anew"
    assert find(kept, caller("/b")) is None
    assert find(kept, A, NOW + 1) is None
    assert len(kept) == 0


@pytest.mark.parametrize("what", ["registry", "imports", "demand", "parameters", "mirrors", "domains"])
def test_it_ends_with_every_version(kept: KeptAnswers, tables: MasterTables, what: str) -> None:
    kept.keep(A, NOW, b"call", b"answer")
    match what:
        case "registry":
            tables.registry.version += 1
        case "imports":
            tables.imports.version += 1
        case "demand":
            tables.imports.demand.ask("/t", NOW)
        case "parameters":
            tables.parameters.set("/p", 1)
        case "mirrors":
            tables.imports.mirrors.version += 1
        case _:
            tables.trust.domains.generation += 1
    assert find(kept, A) is None


def test_nothing_is_kept_for_whom_changes_are_not_told_at_once(kept: KeptAnswers) -> None:
    """The time of an answer would tell a caller in slots the moment of a registration."""

    reach = Reach([Permission("/**", Right.SUBSCRIBE)])
    reach.has_slots = True
    slotted = replace(A, reach=reach)
    for who in (slotted, replace(A, is_authority=True), replace(A, is_own_master=True)):
        kept.keep(who, NOW, b"call", b"answer")
    assert len(kept) == 0


def test_each_caller_has_its_share_and_all_have_one(
    kept: KeptAnswers, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept_answers, "MAX_BYTES_OF_CALLER", 1000)
    monkeypatch.setattr(kept_answers, "MAX_BYTES", 1500)
    for number in range(10):
        kept.keep(A, NOW, b"%d" % number, bytes(100))
    of_one = len(kept)
    assert 0 < of_one < 10
    for name in ("/b", "/c", "/d"):
        kept.keep(caller(name), NOW, b"call", bytes(100))
    assert of_one < len(kept) < of_one + 3
    again = replace(A)  # its rights have changed: what was kept for it makes room
    kept.keep(again, NOW, b"call", bytes(400))
    assert find(kept, again) == bytes(400)
    kept.keep(A, NOW + 1, b"call", b"answer")
    assert len(kept) == 1


def test_what_is_kept_is_a_read_that_needs_no_address() -> None:
    """Then the answer depends on the caller, the arguments and the tables, not on the connection."""
    api = master_api(Registry(), World().trust)
    methods = {name for name, method in api.methods.items() if method.kept}
    assert methods == {
        "lookupNode",
        "lookupService",
        "getSystemState",
        "getTopicTypes",
        "getPublishedTopics",
        "getUri",
        "getPid",
        "getParam",
        "hasParam",
        "searchParam",
        "getParamNames",
    }
    assert all(RULES[name].api is RULES[name].service is None for name in methods)
