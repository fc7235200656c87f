from dataclasses import replace

import pytest

from grants.model import Right
from rossec.master.api.statement_calls import DENIALS, MAX_LACKING, TRUST_STATUS
from rossec.master.rights.caller import RecentDenials
from rossec.master.state.registry import NodeRef, Registry
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything, master_api

NOW = 1_800_000_000
CA = replace(caller("/ca"), is_authority=True)
LIST = b"l"


def node(name: str) -> NodeRef:
    return NodeRef(name, "http://h:1/", name.encode())


class Office:
    def __init__(self) -> None:
        self.statements, self.denials = FakeStatements(), RecentDenials()
        self.statements.update(LIST, NOW)
        self.connected: list[NodeRef] = []
        self.api = master_api(
            Registry(),
            self.statements,
            name="/master",
            uri="http://m:1/",
            pid=7,
            recent_denials=self.denials,
            connected=lambda: self.connected,
        )

    def ask(self, method: str) -> object:
        return call_api(self.api, method, ("/ca",), CA, NOW).answer


@pytest.fixture
def office() -> Office:
    return Office()


def test_the_trust_status_of_the_list_in_force(office: Office) -> None:
    office.connected = [node("/doctor"), node("/heating"), node("/ca"), node("/remote/hospital/robot")]
    office.statements.held_lists.record(office.connected[0], LIST, NOW)
    answer = {"list": "1.1", "nodes": 2, "holding": 1, "lacking": ["/heating"]}
    assert office.ask(TRUST_STATUS) == [1, "trust status of the revocation list", answer]


def test_the_names_in_an_answer_are_bounded(office: Office) -> None:
    office.connected = [node(f"/n{number:04}") for number in range(MAX_LACKING + 9)]
    match office.ask(TRUST_STATUS):
        case [1, _, {"nodes": nodes, "holding": 0, "lacking": [*lacking]}]:
            assert (nodes, len(lacking)) == (MAX_LACKING + 9, MAX_LACKING)
        case other:
            pytest.fail(str(other))


def test_denials_are_told_by_their_age(office: Office) -> None:
    office.denials.add(NOW - 60, "/eve", Right.SUBSCRIBE, "/scan")
    office.denials.add(NOW + 5, "/bob", Right.CALL, "/reset")  # the clock was set back
    assert office.ask(DENIALS) == [
        1,
        "denials of the last day",
        [[0, "/bob", 4, "/reset"], [60, "/eve", 2, "/scan"]],
    ]


@pytest.mark.parametrize("method", [TRUST_STATUS, DENIALS])
def test_only_the_authoritys_own_node_is_told(office: Office, method: str) -> None:
    for other in (everything("/admin"), caller("/ca")):
        answer = call_api(office.api, method, (other.name,), other, NOW).answer
        assert isinstance(answer, list)
        assert answer[0] == -1
        assert "only the authority's own node /ca may call this" in str(answer[1])
        assert not answer[2]


@pytest.mark.parametrize("method", [TRUST_STATUS, DENIALS])
def test_an_argument_too_many_is_refused(office: Office, method: str) -> None:
    answer = call_api(office.api, method, ("/ca", 1), CA, NOW).answer
    assert answer == [-1, "Error: bad call arity", {} if method == TRUST_STATUS else []]
