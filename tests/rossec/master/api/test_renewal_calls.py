"""The calls by which identities are renewed, over fake statements and a real table."""

from dataclasses import replace
from typing import Any

import pytest

from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import Administered
from rossec.master.rights.renewals import OFFER_LIMIT, IdentityRenewals, Settlement
from rossec.master.state.registry import Registry
from rossec.ros.names import RENEW_IDENTITY, SETTLE_RENEWALS, WATCH_RENEWALS
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything, master_api
from tests.support.authority import Site

CA = replace(caller("/ca"), is_authority=True)


class Table(IdentityRenewals):
    """Takes every answer but those of another request than b"1" * 32."""

    def __init__(self) -> None:
        super().__init__(Site().anchor)
        self.settled = list[Settlement]()

    def settle(self, found: list[Settlement], now: int, check: object) -> int:
        self.settled += found
        return sum(each.digest == b"1" * 32 for each in found)


@pytest.fixture
def api() -> MasterApi:
    statements = FakeStatements()
    statements.identities = Table()  # type: ignore[misc]
    return master_api(Registry(), statements, name="/master", uri="http://m:1/", pid=7)


def ask(api: MasterApi, who: Any, method: str, *params: object) -> Any:
    return call_api(api, method, (who.name, *params), who, 0).answer


def test_an_identity_is_renewed_or_the_reason_is_returned(api: MasterApi) -> None:
    who = caller("/a")
    assert ask(api, who, RENEW_IDENTITY, b"x") == [1, "identity renewed", b"bundle of x"]
    forged = [-1, "rossec: not signed by the old key", b""]
    assert ask(api, who, RENEW_IDENTITY, b"forged") == forged
    later = [0, "rossec: the authority is asked", b""]
    assert ask(api, who, RENEW_IDENTITY, b"later") == later


def test_the_service_of_the_authority_sees_and_answers(api: MasterApi) -> None:
    offered = ask(api, CA, WATCH_RENEWALS, 0)
    assert offered == [1, "renewals", {"renewals": [], "waiting": 0}]
    answers = [[b"1" * 32, b"bundle", ""], [b"2" * 32, b"", "no"]]
    outcome = call_api(api, SETTLE_RENEWALS, ("/ca", answers), CA, 0)
    assert outcome.answer == [1, "settled", 1]
    assert outcome.events == (Administered("/ca", "renewed or refused 1 identities"),)
    assert call_api(api, SETTLE_RENEWALS, ("/ca", []), CA, 0).events == ()


@pytest.mark.parametrize("who", [caller("/eve"), everything("/operator"), caller("/ca")])
def test_nobody_else_does(api: MasterApi, who: Any) -> None:
    for method, argument in ((WATCH_RENEWALS, 0), (SETTLE_RENEWALS, [[b"1" * 32, b"b", ""]])):
        code, status, _ = ask(api, who, method, argument)
        assert (code, status) == (-1, "rossec: only the authority's own node /ca may call this")


@pytest.mark.parametrize(
    "answers",
    [
        b"x",
        [b"x"],
        [[b"1" * 31, b"b", ""]],
        [[b"1" * 32, b"", ""]],
        [[b"1" * 32, b"b", "both"]],
        [[b"1" * 32, "text", ""]],
        [[b"1" * 32, b"b", "", 1]],
        [[b"1" * 32, b"b", ""]] * (OFFER_LIMIT + 1),
    ],
)
def test_answers_have_one_form(api: MasterApi, answers: object) -> None:
    code, status, value = ask(api, CA, SETTLE_RENEWALS, answers)
    assert (code, value) == (-1, 0)
    assert status.startswith("ERROR: parameter [answers]")
