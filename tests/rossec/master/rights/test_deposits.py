"""The table of deposits: what is accepted, who is given what, and when it leaves."""

from collections.abc import Iterable

import pytest

from ca.errors import HintedError, Revoked
from grants import document
from grants.errors import GrantError, GrantExpired, GrantForged
from grants.model import Grant, Right
from grants.token import pack
from rossec.master.rights import held_grants as module
from rossec.master.rights.held_grants import DeliveryState, Deposits, Missing, verifier
from rossec.master.state.journals import DepositChange, GrantDeposited, GrantHeld
from tests.support.authority import DAY, EnrolledNode, Site

NONE = frozenset[bytes]()
P = {"/p": Right.PUBLISH}


class Table:
    """Deposits with what they persisted."""

    def __init__(self) -> None:
        self.site = Site()
        self.now = self.site.now
        self.robot, self.camera = self.site.enroll("/robot"), self.site.enroll("/camera")
        self.revoked: set[bytes] = set()
        self.persisted: list[DepositChange] = []
        self.verify = verifier(self.site.anchor, self.check)
        self.deposits = Deposits(self.verify, self.persisted.extend)

    def check(self, entry: bytes, now: int) -> None:
        assert now >= self.now
        if entry in self.revoked:
            raise Revoked("it is revoked")

    def grant(self, node: EnrolledNode | None = None, **options: int) -> bytes:
        return self.site.grant(self.robot if node is None else node, P, **options)

    def add(self, *grants: bytes) -> list[str]:
        found: list[tuple[bytes, Grant | HintedError]] = []
        for data in grants:
            try:
                found.append((data, self.verify(data, self.now)))
            except HintedError as error:
                found.append((data, error))
        return self.deposits.add(found)

    def missing(self, node: EnrolledNode, *known: bytes, later: int = 0) -> Missing:
        revoked = frozenset(self.revoked)
        return self.deposits.missing(node.thumbprint, known, self.now + later, revoked)

    def states(self, *grants: bytes) -> list[DeliveryState]:
        return [self.deposits.state(document.grant_id(data)) for data in grants]


@pytest.fixture
def table() -> Table:
    return Table()


def test_only_what_the_authority_signed_and_is_in_force_is_accepted(table: Table) -> None:
    other = Site()
    with pytest.raises(GrantForged):
        table.verify(other.grant(table.robot, P), table.now)
    foreign = Site(domain="away")
    foreign.signer = table.site.signer
    with pytest.raises(GrantForged, match="trust domain"):
        table.verify(foreign.grant(table.robot, P), table.now)
    renewed = pack(table.grant(), b"ticket", b"delegation")
    for data in (b"noise", renewed):
        with pytest.raises(GrantForged):
            table.verify(data, table.now)
    old = table.grant(start=-DAY, lifetime=60)
    with pytest.raises(GrantExpired, match="of /robot has expired"):
        table.verify(old, table.now)
    renewable = table.grant(start=-DAY, lifetime=60, cap=2 * DAY)
    assert table.verify(renewable, table.now).subject == "/robot", "the master may renew it"
    data = table.grant()
    for entry in (document.grant_id(data), table.robot.thumbprint):
        table.revoked = {entry}
        with pytest.raises(Revoked):
            table.verify(data, table.now)


def test_without_a_verifier_nothing_is_accepted() -> None:
    with pytest.raises(GrantError, match="takes no deposits"):
        Deposits().verify(b"any", 0)


def test_a_refused_grant_does_not_affect_the_others(table: Table) -> None:
    one, two, forged = table.grant(), table.grant(), Site().grant(table.robot, P)
    reasons = table.add(one, forged, two)
    assert reasons[::2] == ["", ""]
    assert "not a grant of this authority" in reasons[1]
    assert table.persisted == [GrantDeposited(one), GrantDeposited(two)]
    assert len(table.deposits) == 2


def test_a_key_is_given_its_own_grants_which_it_lacks(table: Table) -> None:
    one, two, other = table.grant(), table.grant(), table.grant(table.camera)
    table.add(one, two, other)
    assert table.states(one, other) == [DeliveryState.WAITING] * 2
    assert table.missing(table.robot) == ([one, two], False)
    assert table.states(one, other) == [DeliveryState.FETCHED, DeliveryState.WAITING]
    assert table.missing(table.robot, document.grant_id(one)) == ([two], False)
    assert table.missing(table.site.enroll("/eve")) == ([], False)


def test_an_answer_is_bounded(table: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    grants = [table.grant() for _ in range(3)]
    table.add(*grants)
    monkeypatch.setattr(module, "ANSWER_BYTES", len(grants[0]) + 1)
    assert table.missing(table.robot) == (grants[:1], True)
    known = [document.grant_id(data) for data in grants[:2]]
    assert table.missing(table.robot, *known) == (grants[2:], False)
    monkeypatch.setattr(module, "ANSWER_BYTES", 1)
    assert table.missing(table.robot) == (grants[:1], True), "one is always sent"


def test_what_has_ended_or_is_revoked_is_not_given_and_leaves(table: Table) -> None:
    short, long = table.grant(lifetime=60), table.grant()
    renewable, other = table.grant(lifetime=60, cap=120), table.grant(table.camera)
    table.add(short, long, renewable, other)
    assert table.missing(table.robot, later=60).grants == [long, renewable]
    table.deposits.drop_ended(table.now + 60, NONE)
    assert table.states(short, renewable)[0] is DeliveryState.UNKNOWN
    assert len(table.deposits) == 3
    table.deposits.drop_ended(table.now + 120, NONE)
    assert len(table.deposits) == 2
    table.revoked = {document.grant_id(long)}
    assert table.missing(table.robot).grants == []
    table.revoked = {table.camera.thumbprint}
    assert table.missing(table.camera).grants == []
    table.deposits.drop_ended(table.now, frozenset({document.grant_id(long)}))
    table.deposits.drop_ended(table.now, frozenset({table.camera.thumbprint}))
    assert len(table.deposits) == 0
    assert table.deposits.changes() == []


def test_a_deposit_again_changes_nothing_another_signature_replaces_it(table: Table) -> None:
    data = table.grant()
    table.add(data)
    assert table.add(data) == [""]
    assert len(table.persisted) == 1
    table.deposits.presented(table.robot.thumbprint, [data])
    claims = document.GRANT.open(data, table.site.anchor.public_key)
    again = document.GRANT.sign(table.site.signer, claims)
    assert again != data
    assert document.grant_id(again) == document.grant_id(data)
    assert table.add(again) == [""]
    assert table.missing(table.robot).grants == [again]
    assert table.states(again) == [DeliveryState.HELD]
    assert len(table.deposits) == 1


def test_the_grants_of_one_key_are_bounded(table: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_HELD", 3)
    grants = [table.grant() for _ in range(4)]
    assert table.add(grants[0]) == [""]
    reasons = table.add(*grants[1:])
    assert reasons[:2] == ["", ""]
    assert reasons[2] == "the master takes at most 3 grants of one node"
    assert table.add(table.grant(table.camera)) == [""], "others are not affected"
    monkeypatch.setattr(module, "MAX_HELD_BYTES", 1)
    assert "at most" in table.add(table.grant(table.site.enroll("/eve")))[0]


@pytest.mark.parametrize("limit", ["MAX_TOTAL", "MAX_TOTAL_BYTES"])
def test_all_grants_together_are_bounded(table: Table, monkeypatch: pytest.MonkeyPatch, limit: str) -> None:
    one, two = table.grant(), table.grant(table.camera)
    monkeypatch.setattr(module, limit, 1 if limit == "MAX_TOTAL" else len(two))
    assert table.add(one, two) == ["", "the master holds 1 grants and takes no more"]
    assert table.add(two) == ["the master holds 1 grants and takes no more"]
    table.deposits.drop_ended(table.now, frozenset({document.grant_id(one)}))
    assert table.add(two) == [""]


def test_what_cannot_be_made_durable_is_not_in_the_table(table: Table) -> None:
    def fail(changes: Iterable[DepositChange]) -> None:
        raise GrantError("the disk is full")

    full, data = Deposits(table.verify, fail), table.grant()
    with pytest.raises(GrantError, match="full"):
        full.add([(data, table.verify(data, table.now))])
    assert len(full) == 0
    assert full.add([]) == []


def test_a_grant_is_held_once_its_holder_presents_it(table: Table) -> None:
    one, two = table.grant(), table.grant()
    table.add(one, two)
    deposits = table.deposits
    deposits.presented(table.camera.thumbprint, [one])
    assert table.states(one) == [DeliveryState.WAITING], "another key"
    deposits.presented(table.robot.thumbprint, [b"\x83noise", one])
    deposits.presented(table.robot.thumbprint, [one])
    assert table.states(one, two) == [DeliveryState.HELD, DeliveryState.WAITING]
    assert deposits.unsaved == [GrantHeld(document.grant_id(one))], "recorded once"
    assert table.missing(table.robot).grants == [one, two], "its other nodes may lack it"
    assert table.states(one) == [DeliveryState.HELD]


def test_a_journal_restores_the_table(table: Table) -> None:
    one, two = table.grant(), table.grant(table.camera)
    table.add(one, two)
    table.deposits.presented(table.robot.thumbprint, [one])
    again = Deposits()
    unknown: list[DepositChange] = [GrantDeposited(b"of another version"), GrantHeld(bytes(16))]
    again.restore([*unknown, *table.deposits.changes()])
    assert again.state(document.grant_id(one)) is DeliveryState.HELD
    assert again.state(document.grant_id(two)) is DeliveryState.WAITING
    assert again.changes() == table.deposits.changes()
    again.drop_ended(table.now + DAY, NONE)
    assert len(again) == 0
