"""The calls about grants, delegations and revocations, over fake statements."""

from typing import Any

import pytest

from ca.encoding import decode, encode
from grants.model import Right
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import CallerPresentedGrants, CallOutcome, RevocationsChanged
from rossec.master.api.statement_calls import PRESENT_LIMIT
from rossec.master.rights.caller import Caller
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything, master_api, run_to_end


@pytest.fixture
def statements() -> FakeStatements:
    return FakeStatements()


@pytest.fixture
def api(statements: FakeStatements) -> MasterApi:
    return master_api(Registry(), statements, name="/master", uri="http://m:1/", pid=7)


def ask(api: MasterApi, who: Caller, method: str, *params: object) -> Any:
    return call_api(api, method, params, who, 0).answer


def test_presented_grants_are_counted(api: MasterApi, statements: FakeStatements) -> None:
    outcome = call_api(api, "rossec.presentGrants", ("/a", [b"one", b"two"]), caller("/a"), 0)
    assert outcome.answer == [1, "grants accepted", 2]
    assert outcome.events == (CallerPresentedGrants("/a"),)
    assert statements.presented == [b"one", b"two"]
    good_and_bad = ask(api, caller("/a"), "rossec.presentGrants", "/a", [b"forged", b"three"])
    assert good_and_bad == [1, "grants presented, but refused: forged", 3]


def test_grants_are_verified_in_turns(api: MasterApi, statements: FakeStatements) -> None:
    params = ("/a", [b"one", b"forged", b"two"])
    work = api.begin("rossec.presentGrants", params, caller("/a"), 0)
    assert not isinstance(work, CallOutcome)
    next(work)
    assert statements.presented == [b"one"]
    outcome = run_to_end(work)
    assert outcome.answer == [1, "grants presented, but refused: forged", 2]
    assert statements.presented == [b"one", b"two"]


def test_a_node_without_a_valid_grant_keeps_its_session(api: MasterApi) -> None:
    outcome = call_api(api, "rossec.presentGrants", ("/a", [b"forged"] * 2), caller("/a"), 0)
    assert outcome.answer == [1, "grants presented, but refused: forged; forged", 0]
    assert outcome.events == (CallerPresentedGrants("/a", ("forged", "forged")),)


@pytest.mark.parametrize("value", [5, b"x", ["text"], [b"x"] * (PRESENT_LIMIT + 1)])
def test_grants_are_a_bounded_list_of_base64(api: MasterApi, value: object) -> None:
    code, status, _ = ask(api, caller("/a"), "rossec.presentGrants", "/a", value)
    assert code == -1
    assert status.startswith("ERROR: parameter [grants] must")


def test_revocations_are_returned_with_a_timestamp(api: MasterApi) -> None:
    who = caller("/a")
    assert ask(api, who, "rossec.revocations", "/a")[2] == [b"", b""]
    outcome = call_api(api, "rossec.updateRevocations", ("/a", b"list 2"), who, 0)
    assert outcome.answer == [1, "revocations updated", 1]
    assert outcome.events == (RevocationsChanged("/a"),)
    again = call_api(api, "rossec.updateRevocations", ("/a", b"list 1"), who, 0)
    assert again.answer == [1, "not newer than the list in force", 0]
    assert again.events == ()
    assert ask(api, who, "rossec.revocations", "/a")[2] == [b"list 2", b"stamp"]
    assert ask(api, who, "rossec.updateRevocations", "/a", b"forged")[0] == -1
    assert ask(api, who, "rossec.updateRevocations", "/a", "text")[1].endswith("must be base64")


def test_grants_are_renewed_one_by_one(api: MasterApi) -> None:
    outcome = call_api(api, "rossec.renewGrants", ("/a", [b"one", b"forged"]), caller("/a"), 0)
    assert outcome.answer == [1, "grants renewed, but refused: forged", [b"renewed one", b""]]
    assert outcome.events == (CallerPresentedGrants("/a", ("forged",)),)
    assert ask(api, caller("/a"), "rossec.renewGrants", "/a", [b"one"])[1] == "grants renewed"


def test_a_newer_delegation_is_accepted(api: MasterApi) -> None:
    answers = [
        ask(api, caller("/a"), "rossec.updateDelegation", "/a", data)
        for data in (b"newer", b"older", b"forged")
    ]
    assert [answer[::2] for answer in answers] == [[1, 1], [1, 0], [-1, 0]]


def test_the_list_is_sent_only_to_nodes_without_it(api: MasterApi, statements: FakeStatements) -> None:
    statements.lists.append(b"list 1")
    since = "rossec.revocationsSince"
    assert ask(api, caller("/a"), since, "/a", b"other")[2] == [b"list 1", b"stamp"]
    assert ask(api, caller("/a"), since, "/a", b"list 1")[2] == [b"", b"stamp"]


def full_set(answer: Any) -> object:
    value: Any = decode(answer[2])
    return value[0]


def test_a_node_receives_the_entries_that_pertain_to_it(api: MasterApi) -> None:
    node = caller("/a", {"/t": Right.PUBLISH})
    query = encode({})
    assert full_set(ask(api, node, "rossec.trl", "/a", query)) == []
    ask(api, node, "registerPublisher", "/a", "/t", "*", "http://a:1/")
    answer = ask(api, node, "rossec.trl", "/a", query)
    assert (answer[0], full_set(answer)) == (1, [b"one"])
    reader = caller("/r", {"/**": Right.PARAM_GET})
    ask(api, everything("/w"), "setParam", "/w", "/p", 1)
    for key in ("/t", "/"):
        ask(api, reader, "subscribeParam", "/r", "http://r:1/", key)
    assert full_set(ask(api, reader, "rossec.trl", "/r", query)) == [b"one"]
    admin = caller("/admin", {"/master": Right.ADMIN})
    assert full_set(ask(api, admin, "rossec.trl", "/admin", query)) == [b"one", b"two"]


def test_a_malformed_query_is_refused(api: MasterApi) -> None:
    answer = ask(api, everything("/a"), "rossec.trl", "/a", b"garbage")
    assert (answer[0], answer[2]) == (-1, b"")
    assert answer[1].startswith("rossec: not a query")


def test_a_tree_and_its_proofs(api: MasterApi) -> None:
    update = "rossec.updateRevocationTree"
    outcome = call_api(api, update, ("/a", b"tree", b"entries"), caller("/a"), 0)
    assert outcome.answer == [1, "revocations updated", 1]
    assert outcome.events == (RevocationsChanged("/a"),)
    assert ask(api, caller("/a"), update, "/a", b"tree", b"entries")[2] == 0
    assert ask(api, caller("/a"), update, "/a", b"for", b"ged")[0] == -1
    answer = ask(api, caller("/a"), "rossec.revocationProofs", "/a", [b"x", b"y"])
    assert answer[2] == [b"proof of x", b"proof of y"]
