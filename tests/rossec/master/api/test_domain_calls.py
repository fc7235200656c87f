"""The calls about foreign domains, over a real state of trust."""

from typing import Any

import pytest

from ca.revocation.lists import digest
from rossec.master.api.methods import CallDenied, DomainsChanged
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import call_api, master_api
from tests.rossec.master.rights.test_statements_foreign import Home
from tests.rossec.master.visiting import HOSPITAL


class Calls(Home):
    def __init__(self) -> None:
        super().__init__()
        self.api = master_api(Registry(), self.trust, name="/master", uri="http://m:1/", pid=7)
        self.events: tuple[object, ...] = ()

    def ask(self, method: str, *params: object, foreign: bool = False) -> Any:
        member = self.robot if foreign else self.node
        who = self.trust.caller(self.identity(member), self.now)
        found = call_api(self.api, method, (member.name, *params), who, self.now)
        self.events = found.events
        return found.answer


@pytest.fixture
def calls() -> Calls:
    return Calls()


def test_the_list_of_domains_is_sent_to_who_lacks_it(calls: Calls) -> None:
    data = calls.trust.domains.anchors.data
    assert calls.ask("rossec.domains", b"") == [1, "domains", data]
    assert calls.ask("rossec.domains", digest(data)) == [1, "domains", b""]


def test_a_newer_list_of_domains_is_taken_once(calls: Calls) -> None:
    newer = calls.lists.next()
    assert calls.ask("rossec.updateDomains", newer)[2] == 1
    assert [*calls.events] == [DomainsChanged("/node")]
    assert calls.ask("rossec.updateDomains", newer) == [1, "not newer than the list in force", 0]
    assert len(calls.events) == 0


def test_a_forged_list_of_domains_is_refused(calls: Calls) -> None:
    code, status, value = calls.ask("rossec.updateDomains", b"garbage")
    assert (code, value) == (-1, 0)
    assert status.startswith("rossec: not a list of domains of this authority")


def test_foreign_revocations_are_relayed(calls: Calls) -> None:
    word = calls.trust.domains.word(HOSPITAL)
    whole = [1, "revocations", [word.revocations, word.timestamp, list(word.chain)]]
    assert calls.ask("rossec.foreignRevocations", HOSPITAL, b"") == whole
    held = [1, "revocations", [b"", word.timestamp, list(word.chain)]]
    assert calls.ask("rossec.foreignRevocations", HOSPITAL, word.digest()) == held


def test_proofs_of_a_list_are_none(calls: Calls) -> None:
    answer = calls.ask("rossec.foreignRevocationProofs", HOSPITAL, [b"x" * 16])
    assert answer == [1, "proofs", []]


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("rossec.foreignRevocations", ("clinic.example", b"")),
        ("rossec.foreignRevocationProofs", ("clinic.example", [])),
    ],
)
def test_of_a_domain_that_is_not_listed_nothing_is_known(
    calls: Calls, method: str, params: tuple[object, ...]
) -> None:
    code, status, default = calls.ask(method, *params)
    assert (code, default) == (-1, [])
    assert status == "rossec: domain 'clinic.example' is not listed here"


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("rossec.domains", (b"",)),
        ("rossec.updateDomains", (b"",)),
        ("rossec.foreignRevocations", (HOSPITAL, b"")),
        ("rossec.foreignRevocationProofs", (HOSPITAL, [])),
    ],
)
def test_foreigners_ask_their_own_master(calls: Calls, method: str, params: tuple[object, ...]) -> None:
    code, status, _ = calls.ask(method, *params, foreign=True)
    assert (code, status) == (-1, "rossec: only nodes of the own domain may call this")
    [denied] = calls.events
    assert isinstance(denied, CallDenied)
    assert denied.node == "hospital:/rounds/robot3"
