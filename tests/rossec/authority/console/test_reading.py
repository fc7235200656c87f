"""What the console shows of the record."""

from pathlib import Path
from typing import NamedTuple

import pytest

from ca.approvals.passkeys import Approval, Assertion
from ca.approvals.statement import Invitation, NewPasskey, StatementKind
from ca.encoding import Value
from ca.store.log import ApprovalState
from grants.document import peek
from rossec.authority import invitations
from rossec.authority.console import queries as module
from rossec.authority.console.messages import (
    ApprovalView,
    EventView,
    GrantView,
    IdentityRequestView,
    InvitationView,
    NodeView,
    PhoneView,
    from_value,
    sentence,
)
from rossec.authority.console.queries import KEPT, MAX_APPROVALS, MAX_EVENTS, RecordQueries, bounded
from rossec.home import NodeHome
from tests.support import approving, passkeys
from tests.support.consolework import NOW, ConsoleWork, ask, many


@pytest.fixture
def site(tmp_path: Path) -> ConsoleWork:
    return ConsoleWork(tmp_path)


@pytest.fixture
def reading(site: ConsoleWork) -> RecordQueries:
    return RecordQueries(site.work, lambda number: (number == approving.PASSKEY.id) * (NOW + 5))


def never(_: bytes) -> int:
    return 0


def test_nodes_are_the_newest_of_a_name_and_other_valid_keys(site: ConsoleWork) -> None:
    reading = RecordQueries(site.work, never)
    site.enroll("/robot")
    site.home.store().revoke(b"u" * 32, "x", NOW)
    found = many(NodeView, ask(reading, "nodes"))
    assert [each.name for each in found] == ["/robot", "/ca"]
    assert (found[0].revoked_at, found[0].anonymous, found[0].not_after > NOW) == (0, False, True)
    site.home.store().revoke(found[0].key, "sold", NOW + 1)
    (robot, _) = many(NodeView, ask(reading, "nodes"))
    assert (robot.revoked_at, robot.reason) == (NOW + 1, "sold")
    site.wait(60)
    (site.root / "elsewhere").rename(site.root / "before")
    site.enroll("/robot")
    assert [each.reason for each in many(NodeView, ask(reading, "nodes"))] == ["", ""]


def test_grants_are_those_in_force_and_ended_of_late(site: ConsoleWork) -> None:
    site.enroll("/doctor")
    short, long = site.grant("/doctor", 60), site.grant("/doctor", 400 * 86400, "rule 3")
    reading = RecordQueries(site.work, never, lambda: {long: "held"})
    found = many(GrantView, ask(reading, "grants"))
    assert [(each.id, each.rules, each.delivery) for each in found] == [
        (long, "rule 3", "held"),
        (short, "", ""),
    ]
    assert (found[1].at, found[1].expires, found[1].cap) == (NOW, NOW + 60, NOW + 60)
    assert peek(found[0].data).id == long
    site.wait(KEPT + 61)
    assert [each.id for each in many(GrantView, ask(reading, "grants"))] == [long]
    site.home.store().revoke(long, "moved out", site.now)
    (ended,) = many(GrantView, ask(reading, "grants"))
    assert (ended.revoked_at, ended.reason) == (site.now, "moved out")
    site.wait(KEPT + 1)
    assert ask(reading, "grants") == []


def test_grants_of_a_revoked_key_are_revoked(site: ConsoleWork) -> None:
    site.enroll("/doctor")
    site.grant("/doctor", 60)
    store = site.home.store()
    store.revoke(store.valid_certificate("/doctor", NOW).thumbprint, "gone", NOW + 2)
    (view,) = many(GrantView, ask(RecordQueries(site.work, never), "grants"))
    assert (view.revoked_at, view.reason) == (NOW + 2, "gone")


def test_requests_for_identities_are_those_that_wait(site: ConsoleWork) -> None:
    reading = RecordQueries(site.work, never)
    site.enroll("/robot")
    with site.work.service("a test") as service:
        for name in ("/lamp", "/robot"):
            node = NodeHome.of(site.root / "other", name)
            asked = node.create_request("home")
            service.identities.add_request(asked, node.request(), "a code")
    found = many(IdentityRequestView, ask(reading, "identity-requests"))
    assert {(each.name, each.is_other_key) for each in found} == {("/lamp", False), ("/robot", True)}
    lamp = next(each for each in found if each.name == "/lamp")
    assert (lamp.state, lamp.source, lamp.csr) == (
        "pending",
        "a code",
        NodeHome.of(site.root / "other", "/lamp").request(),
    )
    site.home.store().requests.deny(lamp.id, NOW)
    site.wait(2 * 86400)
    assert ask(reading, "identity-requests") == []


def test_invitations_say_what_they_are_and_no_secret(site: ConsoleWork) -> None:
    code = invitations.invite(site.home, "/lamp/*", 3, NOW + 60, "host:1", NOW)
    answer = ask(RecordQueries(site.work, never), "invitations")
    (view,) = many(InvitationView, answer)
    assert (view.pattern, view.uses, view.names, view.state) == ("/lamp/*", 3, (), "open")
    assert code.secret.hex() not in repr(answer)
    assert code.secret not in [item for each in view for item in [each]]
    site.wait(61)
    assert from_value(InvitationView, ask_first(site)).state == "expired"


def ask_first(site: ConsoleWork) -> Value:
    found = ask(RecordQueries(site.work, never), "invitations")
    assert isinstance(found, list)
    return found[0]


def test_phones_and_approvals(site: ConsoleWork, reading: RecordQueries) -> None:
    store, other = site.home.store(), approving.registered(passkeys.Passkey(), "Ben's")
    store.passkeys.add(approving.PASSKEY)
    statement = approving.state(NewPasskey(other.id, b"d" * 32, "Ben's"), store=store)
    touch = approving.DEVICE.sign(statement.challenge)
    given = Approval.of(statement, b"", Assertion(*touch), NOW + 3)
    store.approvals.add(given)
    store.passkeys.add(other._replace(approval=given.id))
    ann, ben = many(PhoneView, ask(reading, "phones"))
    assert (ann.name, ann.last_used, ann.added_by, ann.ended) == ("Ann's phone", NOW + 5, "", "")
    assert (ben.name, ben.last_used, ben.added_by, ben.ended) == ("Ben's", 0, "Ann's phone", "")
    (view,) = many(ApprovalView, ask(reading, "approvals", 9))
    assert view == ApprovalView(
        given.id, int(StatementKind.PASSKEY), "phone Ben's", "Ann's phone", NOW + 3, "waiting", ""
    )
    store.approvals.end(given.id, ApprovalState.DONE, "added", NOW + 4)
    store.remove_passkey(ann.id, "", NOW + 6)
    (view,) = many(ApprovalView, ask(reading, "approvals", 9))
    assert (view.state, view.result) == ("done", "added")
    assert [each.ended for each in many(PhoneView, ask(reading, "phones"))] == ["removed", ""]
    assert ask(reading, "approvals", 0) == ask(reading, "approvals", -1) == []


def test_events_are_read_in_pages(site: ConsoleWork, reading: RecordQueries) -> None:
    for number in range(10):
        site.home.store().log_event("note", f"{number}", "", NOW)
    everything = many(EventView, ask(reading, "events", 0, MAX_EVENTS + 1))
    numbers = [each.number for each in everything]
    assert numbers == list(range(len(numbers)))[::-1]
    assert everything[0][1:] == (NOW, "note", "9", "")
    first = many(EventView, ask(reading, "events", 0, 4))
    then = many(EventView, ask(reading, "events", first[-1].number, 4))
    assert first + then == everything[:8]
    assert ask(reading, "events", 0, -5) == []
    latest = ask(reading, "events", (1 << 64) - 1, 1)  # more than the record can count
    assert latest == ask(reading, "events", 0, 1)
    assert MAX_APPROVALS < MAX_EVENTS


def test_an_answer_is_bounded_and_says_so(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(module, "ROOM", 100)
    views = [EventView(number, 0, "x" * 10, "", "") for number in range(100)]
    assert len(bounded("entries", views)) == 100 // len(b"\x85\1\0\x6axxxxxxxxxx\x60\x60")
    assert "shown the newest 6 entries only" in caplog.text


def test_an_invitation_that_was_approved_is_in_words() -> None:
    statement = approving.state(Invitation("/lamp/*", 3, NOW + 60, wildcard=False))
    assert sentence(statement, b"") == "join code for 3 of /lamp/*"


class _View(NamedTuple):
    node: str
    text: str


@pytest.mark.attack("looker-floods")
def test_what_one_node_has_pushes_nothing_of_another_out(monkeypatch: pytest.MonkeyPatch) -> None:
    views = [_View("/many", f"{number:040}") for number in range(330)]
    views += [_View("/one", "x"), _View("/one", "y")]
    monkeypatch.setattr(module, "ROOM", 1000)
    shown = bounded("grants", views, lambda view: view.node)
    assert shown[-2:] == [["/one", "x"], ["/one", "y"]]
    assert shown[0] == ["/many", f"{0:040}"]
    assert 10 < len(shown) < 30
    chosen = module.shared(views, lambda view: view.node, 10)
    assert [view.node for view in chosen] == ["/many"] * 8 + ["/one"] * 2
