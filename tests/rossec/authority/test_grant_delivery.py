"""How the authority delivers grants: its calls at the master, and what becomes of the answers."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from ca.revocation.trust_status import open_statement
from grants import document
from grants.model import Draft, Permission, Right
from rossec.authority import grant_operations as module
from rossec.authority.grant_operations import RefusedDeposit, require_delivered
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.errors import NotDelivered
from rossec.home import NodeHome
from tests.rossec.authority.test_service import DAY, Office


class Delivering(Office):
    """An office whose master has a table of deposits, and refuses what is in `refuses`."""

    def __init__(self, root: Path) -> None:
        self.states: dict[bytes, str] = {}
        self.refuses: dict[bytes, str] = {}
        self.answer: object = None
        self.lacks = False  # the newest list, so it refuses everything
        self.trust_status: object = None
        super().__init__(root)

    def opened(self) -> AuthorityService:
        return AuthorityService(self.root, self._passphrase, self.respond, lambda: self.now)

    def respond(self, call: StatementCall) -> object:
        self._deliver(call)
        if call.method == "rossec.revocationStatus":
            return self.said_of_its_list()
        if call.method == "rossec.updateRevocations":
            self.lacks = False
            return 1
        (items,) = call.statement
        assert isinstance(items, list)
        if self.answer is not None:
            return self.answer
        if call.method == "rossec.deliveryStates":
            return [self.states.get(item[:16], "") for item in items]
        assert call.method == "rossec.depositGrants"
        if self.lacks:
            return ["no list" for _ in items]
        accepted = [item for item in items if item not in self.refuses]
        self.states |= {document.grant_id(item): "waiting" for item in accepted}
        return [self.refuses.get(item, "") for item in items]

    def said_of_its_list(self) -> object:
        if isinstance(self.trust_status, Exception):
            raise self.trust_status
        if self.trust_status is not None:
            return self.trust_status
        newest = open_statement(self.home.revocation_list(), self.home.anchor().public_key)
        epoch, seq = (0, 0) if self.lacks else newest.number
        return {"list": f"{epoch}.{seq}"}

    def methods(self) -> list[str]:
        return [call.method.removeprefix("rossec.") for call in self.calls]

    def grant(self, name: str = "/robot", lifetime: int = DAY, renewal: int = 0) -> bytes:
        permissions = (Permission("/p", Right.PUBLISH),)
        _, data = self.service.grants.sign(name, permissions, lifetime, renewal)
        return data

    def move_away(self, name: str) -> None:
        NodeHome.of(self.root, name).path.rename(self.root / f"away{name.replace('/', '-')}")

    def made(self, method: str) -> list[Any]:
        return [call.statement[0] for call in self.calls if call.method == method]


@pytest.fixture
def office(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Delivering:
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    return Delivering(tmp_path / "office")


def test_a_grant_is_stored_for_a_node_of_this_home_only(office: Delivering) -> None:
    data = office.grant()
    path = office.service.grants.store(data)
    assert path == NodeHome.of(office.root, "/robot").path
    assert NodeHome.of(office.root, "/robot").grants() == [data]
    office.move_away("/robot")
    assert office.service.grants.store(data) is None
    assert office.calls == []


def test_grants_are_deposited_and_those_of_this_home_stored_too(office: Delivering) -> None:
    office.enroll("/camera")
    one, two = office.grant(), office.grant("/camera")
    office.move_away("/camera")
    office.refuses = {two: "no more\x1b room"}
    asked = office.asked
    office.service.close()
    refused = office.service.grants.deposit([one, two])
    assert [(each.grant_id, each.node) for each in refused] == [(document.grant_id(two), "/camera")]
    assert refused[0].reason.isprintable(), "it is another host's text"
    assert office.made("rossec.depositGrants") == [[one, two]]
    assert office.robot.grants() == [one]
    assert office.asked == asked, "no passphrase is needed"
    call, asked_after = office.calls
    assert (call.node.name, call.what, call.within) == ("/ca", "the grants", 15.0)
    assert asked_after.method == "rossec.revocationStatus"


def test_grants_are_deposited_in_calls_that_the_master_takes(
    office: Delivering, monkeypatch: pytest.MonkeyPatch
) -> None:
    grants = [office.grant() for _ in range(5)]
    monkeypatch.setattr(module, "DEPOSIT_LIMIT", 2)
    assert office.service.grants.deposit(iter(grants)) == []
    assert office.made("rossec.depositGrants") == [grants[:2], grants[2:4], grants[4:]]
    office.calls.clear()
    monkeypatch.setattr(module, "DEPOSIT_BYTES", len(grants[0]) + 1)
    office.service.grants.deposit(grants[:2])
    assert office.made("rossec.depositGrants") == [grants[:1], grants[1:2]]
    office.calls.clear()
    assert office.service.grants.deposit([]) == []
    assert office.calls == []


def test_states_are_asked_of_the_grants_in_force(office: Delivering, monkeypatch: pytest.MonkeyPatch) -> None:
    office.enroll("/lost")
    held, ended, renewable, revoked, lost = (
        office.grant(),
        office.grant(lifetime=60),
        office.grant(lifetime=60, renewal=DAY),
        office.grant(),
        office.grant("/lost"),
    )
    office.service.grants.revoke(document.grant_id(revoked).hex(), "a test")
    office.service.identities.revoke("/lost", "a test")
    office.now += 60
    office.states = {document.grant_id(held): "held"}
    monkeypatch.setattr(module, "STATES_LIMIT", 1)
    assert office.service.grants.delivery_states() == {
        document.grant_id(held): "held",
        document.grant_id(renewable): "",
    }
    holder = document.peek(held).holder
    assert office.made("rossec.deliveryStates") == [
        [document.grant_id(data) + holder] for data in (held, renewable)
    ]
    assert ended != lost
    assert office.calls[0].within == 3.0, "a list of grants does not wait for a master that is off"


def test_what_the_master_does_not_have_is_deposited(office: Delivering) -> None:
    one, two, three = office.grant(), office.grant(), office.grant()
    office.states = {document.grant_id(one): "fetched"}
    office.refuses = {three: "too many"}
    count, (refused,) = office.service.grants.deposit_missing()
    assert count == 1
    assert refused._replace(hint="") == RefusedDeposit(document.grant_id(three), "/robot", "too many")
    assert refused.hint.endswith("rossec grant deliver")
    assert office.made("rossec.depositGrants") == [[two, three]]
    office.refuses = {}
    assert office.service.grants.deposit_missing() == (1, [])
    assert office.service.grants.deposit_missing() == (0, [])


@pytest.mark.parametrize("answer", [[], ["", ""], [7], "text", 5])
def test_an_answer_that_does_not_fit_is_an_error(office: Delivering, answer: object) -> None:
    office.grant()
    office.answer = answer
    with pytest.raises(NotDelivered, match="about the grant is malformed") as error:
        office.service.grants.delivery_states()
    assert "rossec grant deliver" in error.value.hint


def test_without_a_master_what_is_here_is_stored_all_the_same(office: Delivering) -> None:
    data = office.grant()
    office.reachable = False
    with pytest.raises(NotDelivered) as error:
        office.service.grants.deposit([data])
    assert "rossec grant deliver" in error.value.hint
    assert office.robot.grants() == [data]
    with pytest.raises(NotDelivered):
        office.service.grants.deposit_missing()


def test_grants_for_other_domains_are_kept_to_be_carried(office: Delivering) -> None:
    own = office.grant()
    foreign = replace(document.peek(own), subject="/remote/hospital/rounds/robot3")
    draft = Draft(**{each.name: getattr(foreign, each.name) for each in fields(Draft)})
    data = office.service.unlock().issue_grant(draft, foreign.not_before)
    assert office.service.grants.deposit([data, own]) == []
    assert office.made("rossec.depositGrants") == [[own]]
    (file,) = office.service.grants.outgoing.iterdir()
    assert file.read_bytes() == data
    assert office.service.grants.deposit_missing() == (0, [])


def test_a_master_that_lacks_the_list_is_given_it_and_asked_again(office: Delivering) -> None:
    """A master in another home that was started, or made anew, since the list was signed."""
    office.enroll("/camera")
    data, other = office.grant(), office.grant("/camera")
    office.lacks = True
    office.refuses = {other: "no room"}
    (refused,) = office.service.grants.deposit([data, other])
    assert (refused.node, refused.reason) == ("/camera", "no room")
    assert office.states == {document.grant_id(data): "waiting"}
    assert office.methods() == ["depositGrants", "revocationStatus", "updateRevocations", "depositGrants"]
    office.calls.clear()
    assert len(office.service.grants.deposit([other])) == 1
    assert "updateRevocations" not in office.methods(), "it has the list: that is not the reason"


@pytest.mark.parametrize("said", [{}, {"list": 5}, "1.1", [], {"list": "1.1 "}])
def test_an_unclear_answer_about_the_list_is_answered_with_it(office: Delivering, said: object) -> None:
    data = office.grant()
    office.lacks, office.trust_status = True, said
    assert office.service.grants.deposit([data]) == []


def test_an_older_master_is_not_asked_again(office: Delivering) -> None:
    """The operator reads what to do."""
    data = office.grant()
    office.lacks, office.trust_status = True, NotDelivered("no such method", "rossec ca publish")
    (refused,) = office.service.grants.deposit([data])
    assert refused.hint == "rossec ca publish; afterwards deliver it with: rossec grant deliver"
    assert "updateRevocations" not in office.methods()


def test_a_list_that_has_expired_is_to_be_signed_first(office: Delivering) -> None:
    data = office.grant(lifetime=200 * DAY)
    office.lacks = True
    office.now += 100 * DAY
    (refused,) = office.service.grants.deposit([data])
    assert refused.hint == "rossec ca refresh; afterwards deliver it with: rossec grant deliver"
    with pytest.raises(NotDelivered, match="1 grant is signed, but not delivered") as caught:
        require_delivered([refused])
    assert caught.value.hint == refused.hint


def test_only_what_the_master_lacks_is_not_delivered() -> None:
    there = RefusedDeposit(bytes(16), "/robot", "no room")
    require_delivered([there._replace(is_here=True)])
    with pytest.raises(NotDelivered, match="2 grants are signed") as caught:
        require_delivered([there, there])
    assert "rossec grant deliver" in caught.value.hint
