"""The calls that deliver grants, with a real authority and a fake of the statements."""

from dataclasses import replace
from typing import Any

import pytest

from grants import document
from grants.errors import GrantError
from grants.model import Right
from rossec.master.api.methods import GrantsDeposited
from rossec.master.api.statement_calls import DEPOSIT_LIMIT, KNOWN_LIMIT, STATES_LIMIT
from rossec.master.rights.caller import Caller
from rossec.master.rights.held_grants import Deposits, verifier
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything, master_api
from tests.support.authority import EnrolledNode, Site

DEPOSIT, FETCH, STATES = "rossec.depositGrants", "rossec.fetchGrants", "rossec.deliveryStates"
CA = replace(caller("/ca"), is_authority=True)


class Office:
    """A master with an authority and a robot."""

    def __init__(self) -> None:
        self.site = Site()
        self.now = self.site.now
        self.robot = self.site.enroll("/robot")
        self.full = False
        self.statements = FakeStatements()
        verify = verifier(self.site.anchor, lambda _entry, _now: None)
        self.deposits = Deposits(verify, self._persist)
        self.api = master_api(
            Registry(), self.statements, name="/master", uri="http://m:1/", pid=7, deposits=self.deposits
        )

    def _persist(self, _: object) -> None:
        if self.full:
            raise GrantError("the disk is full", "make room")

    def grant(self, node: EnrolledNode | None = None) -> bytes:
        return self.site.grant(self.robot if node is None else node, {"/p": Right.PUBLISH})

    def ask(self, who: Caller, method: str, *params: object) -> Any:
        return call_api(self.api, method, (who.name, *params), who, self.now).answer

    def node(self, enrolled: EnrolledNode) -> Caller:
        return replace(caller(enrolled.name), thumbprint=enrolled.thumbprint)


@pytest.fixture
def office() -> Office:
    return Office()


def test_the_authority_deposits_and_the_holder_fetches(office: Office) -> None:
    one, two, camera = office.grant(), office.grant(), office.site.enroll("/camera")
    grants = [one, b"noise", two, office.grant(camera)]
    outcome = call_api(office.api, DEPOSIT, ("/ca", grants), CA, office.now)
    answer: Any = outcome.answer
    code, status, reasons = answer
    assert (code, status) == (1, "3 grants deposited, 1 refused")
    assert [bool(reason) for reason in reasons] == [False, True, False, False]
    holders = frozenset({office.robot.thumbprint, camera.thumbprint})
    assert outcome.events == (GrantsDeposited("/ca", holders, 3),)
    answer = office.ask(office.node(office.robot), FETCH, b"")
    assert answer == [1, "grants", {"grants": [one, two], "more": False}]
    known = document.grant_id(one) + document.grant_id(two)
    assert office.ask(office.node(office.robot), FETCH, known)[2]["grants"] == []
    assert office.ask(office.node(office.robot), "rossec.watchGrants", b"") == answer


@pytest.mark.parametrize("method", [DEPOSIT, STATES])
@pytest.mark.parametrize("who", [caller("/eve"), everything("/operator"), caller("/ca")])
def test_only_the_authoritys_own_node_deposits(office: Office, method: str, who: Caller) -> None:
    code, status, value = office.ask(who, method, [office.grant()])
    assert (code, value) == (-1, [])
    assert status == "rossec: only the authority's own node /ca may call this"
    assert len(office.deposits) == 0


def test_nothing_is_notified_of_what_was_refused(office: Office) -> None:
    outcome = call_api(office.api, DEPOSIT, ("/ca", [b"noise"]), CA, office.now)
    answer: Any = outcome.answer
    assert answer[1] == "0 grants deposited, 1 refused"
    assert outcome.events == ()
    assert office.ask(CA, DEPOSIT, [])[2] == []


def test_what_cannot_be_made_durable_is_refused_as_a_whole(office: Office) -> None:
    office.full = True
    answer = office.ask(CA, DEPOSIT, [office.grant()])
    assert answer == [-1, "rossec: the disk is full (make room)", []]
    assert len(office.deposits) == 0


def test_calls_are_answered_between_verifications(office: Office) -> None:
    grants = [office.grant() for _ in range(20)]
    work = office.api.begin(DEPOSIT, ("/ca", grants), CA, office.now)
    assert not isinstance(work, tuple)
    assert [next(work), next(work)] == [None, None]
    assert len(office.deposits) == 0, "nothing takes effect before the end"


def test_states_are_those_of_the_table_or_of_what_was_presented(office: Office) -> None:
    grants = [office.grant() for _ in range(4)]
    entries = [document.grant_id(data) + office.robot.thumbprint for data in grants]
    office.ask(CA, DEPOSIT, grants[:1])
    office.ask(office.node(office.robot), FETCH, b"")
    office.ask(CA, DEPOSIT, grants[1:2])
    office.statements.presented.append(document.grant_id(grants[2]))
    assert office.ask(CA, STATES, entries)[2] == ["fetched", "waiting", "held", ""]
    office.ask(office.node(office.robot), "rossec.presentGrants", grants[1:2])
    assert office.ask(CA, STATES, entries[1:2])[2] == ["held"]


@pytest.mark.parametrize(
    ("method", "argument"),
    [
        (DEPOSIT, [b"x"] * (DEPOSIT_LIMIT + 1)),
        (DEPOSIT, b"x"),
        (STATES, [b"x" * 47]),
        (STATES, [b"x" * 48] * (STATES_LIMIT + 1)),
        (FETCH, b"x" * 17),
        (FETCH, b"x" * 16 * (KNOWN_LIMIT + 1)),
        (FETCH, [b"x" * 16]),
    ],
)
def test_arguments_are_bounded(office: Office, method: str, argument: object) -> None:
    code, status, value = office.ask(CA, method, argument)
    assert code == -1
    assert status.startswith(("ERROR: parameter", "rossec: "))
    assert not value
