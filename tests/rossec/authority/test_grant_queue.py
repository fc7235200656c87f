"""Requests are decided by the policy, by a person in time, or not at all."""

import secrets
import time
from pathlib import Path

import pytest

from ca.errors import HintedError, RecordUnusable, SignatureError, StoreError
from grants.errors import GrantForged
from grants.filters.compile import PRESETS
from grants.model import Right
from grants.policy.model import Subject
from grants.request import GrantRequest, RequestedRight, sign_request
from rossec.authority import grant_queue as module
from rossec.authority import requests
from rossec.authority.grant_queue import GrantRequestQueue, verdict_change
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

    def queue(self, later: int = 0) -> GrantRequestQueue:
        path = self.root / "p.yaml"
        if not path.exists():
            path.write_text(POLICY)
        return GrantRequestQueue(self.home, PolicyFile.read(path), self.now + later)


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path / "site")


POSE, LIFT = RequestedRight(Right.SUBSCRIBE, "/pose"), RequestedRight(Right.CALL, "/lift")
DOOR = RequestedRight(Right.CALL, "/door")


def test_what_the_policy_allows_is_signed(place: Place) -> None:
    queue = place.queue()
    queue.add_request(place.request(POSE, RequestedRight(Right.PUBLISH, "/toast"), DOOR))
    approvals = queue.pending()  # the door is denied, and answered
    assert [str(item.stored.requested) for item in approvals] == ["subscribe /pose", "publish /toast"]
    ((draft, data),) = queue.sign(place.authority, approvals, lambda verdict: verdict, "policy")
    assert (draft.subject, len(draft.permissions)) == ("/toaster", 2)
    assert place.authority.store.grants()[-1].data == data
    assert queue.pending() == []
    queue.close()


def test_a_person_is_asked_and_may_be_late(place: Place) -> None:
    place.queue().add_request(place.request(LIFT))
    (approval,) = place.queue(later=60).pending()
    assert approval.verdict.effect == "prompt"
    assert place.queue(later=61).pending() == []


@pytest.mark.attack("clock-ahead")
@pytest.mark.parametrize("later", [61, 4000, 10**9])
def test_a_clock_that_is_ahead_for_one_look_answers_nothing(place: Place, later: int) -> None:
    place.queue().add_request(place.request(LIFT))
    assert place.queue(later=later).pending() == []
    (approval,) = place.queue().pending()
    assert approval.verdict.effect == "prompt"


def test_a_person_denies_a_request(place: Place) -> None:
    queue = place.queue()
    queue.add_request(place.request(LIFT))
    queue.deny(queue.pending()[0], "a person")
    assert queue.pending() == []


def test_a_node_that_asks_for_too_much_is_denied(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_PENDING", 2)
    queue = place.queue()
    for _ in range(4):
        queue.add_request(place.request(LIFT))
    assert len(queue.pending()) == 2


def test_a_request_is_taken_once(place: Place) -> None:
    data = place.request(LIFT)
    queue = place.queue()
    queue.add_request(data)
    with pytest.raises(StoreError, match="already recorded"):
        queue.add_request(data)


def test_only_enrolled_nodes_ask_and_only_for_themselves(place: Place) -> None:
    queue = place.queue()
    with pytest.raises(StoreError, match="/other has no valid identity"):
        queue.add_request(place.request(LIFT, name="/other"))
    with pytest.raises(GrantForged):
        queue.add_request(place.request(LIFT, name="/ca"))
    place.authority.revoke(place.node.identity(place.now).thumbprint, "lost", place.now)
    with pytest.raises(StoreError, match="the identity of /toaster is revoked"):
        queue.add_request(place.request(LIFT))


def test_a_node_whose_identity_expired_gets_nothing(place: Place) -> None:
    place.queue().add_request(place.request(POSE))
    assert place.queue(later=4000).pending() == []


def test_the_inbox_is_emptied_and_errors_are_reported(place: Place) -> None:
    asked = GrantRequest("home", "/toaster", place.now, bytes(16), (LIFT,), "")
    requests.put_in_inbox(place.home.path, asked, place.request(LIFT))
    (place.home.path / "inbox" / "bad.request").write_bytes(b"?")
    queue = place.queue()
    (trouble,) = queue.read_inbox()
    assert trouble.startswith("bad.request: not a request")
    assert len(queue.pending()) == 1
    assert requests.inbox_files(place.home.path) == []


def test_signature_errors_have_hints() -> None:
    assert issubclass(SignatureError, HintedError)


def test_two_people_at_the_queue_give_one_answer(place: Place) -> None:
    """The slower one signs nothing, also not the part nobody had answered."""
    place.queue().add_request(place.request(LIFT))
    here, there = place.queue(), place.queue()
    (approval,) = here.pending()
    there.deny(there.pending()[0], "no")
    before = place.authority.store.grants()
    with pytest.raises(StoreError, match="already recorded or answered"):
        here.sign(place.authority, [approval], lambda verdict: verdict, "yes")
    assert place.authority.store.grants() == before


def test_what_cannot_be_signed_is_not_answered(place: Place) -> None:
    """The key was revoked while the passphrase was being typed."""
    queue = place.queue()
    queue.add_request(place.request(POSE))
    approvals = queue.pending()
    place.authority.store.revoke(place.node.identity(place.now).thumbprint, "stolen", place.now)
    with pytest.raises(StoreError, match="the key of /toaster is revoked"):
        queue.sign(place.authority, approvals, lambda verdict: verdict, "policy")
    assert [asked.requested for asked in queue._requests.unanswered()] == [POSE]


def test_a_policy_that_was_changed_meanwhile_is_not_signed_by(place: Place) -> None:
    queue = place.queue()
    queue.add_request(place.request(POSE))
    approvals = queue.pending()
    (place.root / "p.yaml").write_text(POLICY.replace("[/pose]", "[/nothing]"))
    with pytest.raises(ConfigurationError, match="was changed while this command was") as caught:
        queue.sign(place.authority, approvals, lambda verdict: verdict, "policy")
    assert "run the command again" in caught.value.hint
    assert place.authority.store.grants() == []


def test_a_request_that_cannot_be_recorded_stays_in_the_inbox(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = place.home.path / "inbox" / "x.request"
    path.parent.mkdir()
    path.write_bytes(place.request(POSE))
    queue = place.queue()
    with monkeypatch.context() as patched:

        def full(_: bytes) -> None:
            raise RecordUnusable("the disk is full")

        patched.setattr(queue, "add_request", full)
        with pytest.raises(RecordUnusable):
            queue.read_inbox()
    assert path.exists()
    assert queue.read_inbox() == []
    assert not path.exists()
    assert len(queue.pending()) == 1


def test_one_request_is_chosen_by_the_beginning_of_its_id(place: Place) -> None:
    queue = place.queue()
    first = queue.add_request(place.request(LIFT, POSE))  # the pose is allowed: not to be chosen
    (chosen,) = queue.chosen(first.id.hex()[:8].upper())
    assert (chosen.stored.requested, chosen.is_allowed) == (LIFT, False)
    queue.add_request(place.request(LIFT))
    for beginning, message in (("xx", "no open request begins"), ("", "several requests begin")):
        with pytest.raises(ConfigurationError, match=message):
            queue.chosen(beginning)
    queue.close()


NOON = 1_800_000_000
CHANGES = """rossec: 1
robot: r
types: {/pose: geometry_msgs/PoseStamped}
filters: {coarse: {pose.position: {round: {step: 2.0}}}}
rules:
  - {id: p, who: "*", prompt: {subscribe: [/pose, /unknown]}, lifetime: 1w}
"""


def test_a_person_restricts_a_verdict(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(CHANGES)
    policy = PolicyFile.read(path)
    subject = Subject("/toaster", b"k" * 32)
    verdict = policy.decider.decide(subject, Right.SUBSCRIBE, "/pose")
    assert verdict_change(policy, None, NOON, only_today=False)(verdict) == verdict
    assert verdict_change(policy, None, NOON, only_today=True)(verdict).lifetime <= 86400
    for name in ("coarse", next(iter(PRESETS))):
        changed = verdict_change(policy, name, NOON, only_today=False)(verdict)
        assert [item.type for item in changed.restrictions] == ["geometry_msgs/PoseStamped"]
    with pytest.raises(ConfigurationError, match="no filter 'fine'") as caught:
        verdict_change(policy, "fine", NOON, only_today=False)
    assert caught.value.hint.startswith("there are: coarse, ")
    unknown = policy.decider.decide(subject, Right.SUBSCRIBE, "/unknown")
    with pytest.raises(ConfigurationError, match="the type of /unknown is not known here"):
        verdict_change(policy, "coarse", NOON, only_today=False)(unknown)


def test_what_the_policy_allows_by_itself_is_recorded_with_its_rules(place: Place) -> None:
    queue = place.queue()
    queue.add_request(place.request(POSE, LIFT))
    made = queue.sign(place.authority, queue.pending(), lambda verdict: verdict, "policy")
    store = place.authority.store
    rules = {
        draft.permissions[0].pattern: store.policy_grants().get(row.id, "")
        for (draft, _), row in zip(made, store.grants(), strict=True)
    }
    assert rules == {"/pose": "a", "/lift": ""}
    assert made[0][0].not_before < place.now
    queue.close()
