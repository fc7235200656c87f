"""Requests are decided by the policy, by a person in time, or not at all."""

import secrets
import time
from pathlib import Path

import pytest

from ca.errors import HintedError, RecordUnusable, SignatureError, StoreError
from grants.errors import GrantForged
from grants.model import Right
from grants.request import GrantRequest, RequestedRight, sign_request
from rossec.authority import approvals as module
from rossec.authority import requests
from rossec.authority.approvals import ApprovalQueue, seconds_left_today
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import PolicyFile
from rossec.errors import ConfigurationError
from rossec.home import NodeHome

SECRET = "four random words here"
POLICY = """rossec: 1
robot: r
defaults: {decision: deny, prompt_timeout: 60s}
rules:
  - {id: a, who: /toaster, allow: {subscribe: [/pose], publish: [/toast]}}
  - {id: p, who: "*", prompt: {call: [/lift]}, lifetime: 1h}
"""


class Place:
    def __init__(self, root: Path) -> None:
        self.root = root
        self.now = int(time.time())
        self.home = AuthorityHome.create(root, "home", SECRET, self.now)
        self.authority = self.home.unlock(SECRET)
        self.node = NodeHome.of(root, "/toaster")
        self.node.create_request("home")
        bundle = self.authority.issue(self.node.request(), self.now, 3600)
        self.node.install(bundle, self.now)

    def request(self, *rights: RequestedRight, name: str = "/toaster") -> bytes:
        asked = GrantRequest("home", name, self.now, secrets.token_bytes(16), rights, "please")
        return sign_request(self.node.credentials().signer, asked)

    def desk(self, later: int = 0) -> ApprovalQueue:
        path = self.root / "p.yaml"
        if not path.exists():
            path.write_text(POLICY)
        return ApprovalQueue(self.home, PolicyFile.read(path), self.now + later)


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path / "site")


POSE, LIFT = RequestedRight(Right.SUBSCRIBE, "/pose"), RequestedRight(Right.CALL, "/lift")
DOOR = RequestedRight(Right.CALL, "/door")


def test_what_the_policy_allows_is_signed(place: Place) -> None:
    desk = place.desk()
    desk.add_request(place.request(POSE, RequestedRight(Right.PUBLISH, "/toast"), DOOR))
    questions = desk.pending()  # the door is denied, and answered
    assert [str(item.stored.requested) for item in questions] == [
        "subscribe /pose",
        "publish /toast",
    ]
    ((draft, data),) = desk.sign(place.authority, questions, lambda verdict: verdict, "policy")
    assert (draft.subject, len(draft.permissions)) == ("/toaster", 2)
    assert place.authority.store.grants()[-1].data == data
    assert desk.pending() == []
    desk.close()


def test_a_person_is_asked_and_may_be_late(place: Place) -> None:
    place.desk().add_request(place.request(LIFT))
    (question,) = place.desk(later=60).pending()
    assert question.verdict.effect == "prompt"
    assert place.desk(later=61).pending() == []
    assert place.desk().pending() == []  # the answer was no, and stays so


def test_a_person_says_no(place: Place) -> None:
    desk = place.desk()
    desk.add_request(place.request(LIFT))
    desk.deny(desk.pending()[0], "a person")
    assert desk.pending() == []


def test_a_node_that_asks_for_too_much_is_denied(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_PENDING", 2)
    desk = place.desk()
    for _ in range(4):
        desk.add_request(place.request(LIFT))
    assert len(desk.pending()) == 2


def test_a_request_is_taken_once(place: Place) -> None:
    data = place.request(LIFT)
    desk = place.desk()
    desk.add_request(data)
    with pytest.raises(StoreError, match="already recorded"):
        desk.add_request(data)


def test_only_enrolled_nodes_ask_and_only_for_themselves(place: Place) -> None:
    desk = place.desk()
    with pytest.raises(StoreError, match="/other has no valid identity"):
        desk.add_request(place.request(LIFT, name="/other"))
    with pytest.raises(GrantForged):
        desk.add_request(place.request(LIFT, name="/ca"))
    place.authority.revoke(place.node.identity(place.now).thumbprint, "lost", place.now)
    with pytest.raises(StoreError, match="/toaster has no valid identity"):
        desk.add_request(place.request(LIFT))


def test_a_node_whose_identity_expired_gets_nothing(place: Place) -> None:
    place.desk().add_request(place.request(POSE))
    assert place.desk(later=4000).pending() == []


def test_the_inbox_is_emptied_and_trouble_is_told(place: Place) -> None:
    asked = GrantRequest("home", "/toaster", place.now, bytes(16), (LIFT,), "")
    requests.put_in_inbox(place.home.path, asked, place.request(LIFT))
    (place.home.path / "inbox" / "bad.request").write_bytes(b"?")
    desk = place.desk()
    (trouble,) = desk.read_inbox()
    assert trouble.startswith("bad.request: not a request")
    assert len(desk.pending()) == 1
    assert requests.inbox_files(place.home.path) == []


def test_today_ends_at_midnight() -> None:
    left = seconds_left_today(int(time.time()))
    assert 60 <= left <= 86400


def test_refusals_carry_hints() -> None:
    assert issubclass(SignatureError, HintedError)


def test_two_people_at_the_desk_give_one_answer(place: Place) -> None:
    """The slower one signs nothing, also not the part nobody had answered."""
    place.desk().add_request(place.request(LIFT))
    here, there = place.desk(), place.desk()
    (question,) = here.pending()
    there.deny(there.pending()[0], "no")
    before = place.authority.store.grants()
    with pytest.raises(StoreError, match="already recorded or answered"):
        here.sign(place.authority, [question], lambda verdict: verdict, "yes")
    assert place.authority.store.grants() == before


def test_what_cannot_be_signed_is_not_answered(place: Place) -> None:
    """The key was revoked while the passphrase was being typed."""
    desk = place.desk()
    desk.add_request(place.request(POSE))
    questions = desk.pending()
    place.authority.store.revoke(place.node.identity(place.now).thumbprint, "stolen", place.now)
    with pytest.raises(StoreError, match="the key of /toaster is revoked"):
        desk.sign(place.authority, questions, lambda verdict: verdict, "policy")
    assert [asked.requested for asked in desk._requests.unanswered()] == [POSE]


def test_a_policy_that_was_changed_meanwhile_is_not_signed_by(place: Place) -> None:
    desk = place.desk()
    desk.add_request(place.request(POSE))
    questions = desk.pending()
    (place.root / "p.yaml").write_text(POLICY.replace("[/pose]", "[/nothing]"))
    with pytest.raises(ConfigurationError, match="was changed while this command was") as caught:
        desk.sign(place.authority, questions, lambda verdict: verdict, "policy")
    assert "run the command again" in caught.value.hint
    assert place.authority.store.grants() == []


def test_a_request_that_cannot_be_recorded_stays_in_the_inbox(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = place.home.path / "inbox" / "x.request"
    path.parent.mkdir()
    path.write_bytes(place.request(POSE))
    desk = place.desk()
    with monkeypatch.context() as patched:

        def full(_: bytes) -> None:
            raise RecordUnusable("the disk is full")

        patched.setattr(desk, "add_request", full)
        with pytest.raises(RecordUnusable):
            desk.read_inbox()
    assert path.exists()
    assert desk.read_inbox() == []
    assert not path.exists()
    assert len(desk.pending()) == 1
