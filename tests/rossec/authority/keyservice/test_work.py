"""What the service does by itself: joins, the policy, its maintenance."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from ca.certificates import from_pem
from ca.enrollment.invitation import InvitationCode, JoinClaim, JoinRequest
from ca.enrollment.join import (
    AuthorityJoin,
    Issued,
    LiveIdentity,
    NodeJoin,
    RefusedMessage,
    RefuseReason,
    WaitingMessage,
    WaitReason,
    read,
)
from ca.errors import EnrollmentMessageRefused, StoreError
from rossec.authority.grant_operations import PolicyWork
from rossec.authority.home import AuthorityHome
from rossec.authority.invitations import invite
from rossec.authority.keyservice.operations import KeyOperations
from rossec.authority.keyservice.process import operations_of
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.session import StatementCall
from rossec.errors import NotDelivered
from rossec.home import NodeHome
from tests.support.domains import foreign
from tests.support.joining import asked, fresh
from tests.support.pki import Site

NOW, DAY = 1_800_000_000, 86_400
SECRET = "four random words here"
POLICY = """rossec: 1
robot: r
types: {/pose: geometry_msgs/PoseStamped}
rules:
  - {id: a, who: "/fleet/*", allow: {subscribe: [/pose]}}
"""


class Working:
    """An unlocked service in a home of its own, a master that takes everything or nothing."""

    def __init__(self, root: Path, now: int = NOW) -> None:
        self.root, self.now = root, now
        self.home = AuthorityHome.create(root, "home", SECRET, now)
        self.audit: list[str] = []
        self.calls: list[str] = []
        self.reachable = True
        self.operations: KeyOperations = operations_of(self.home, self.audit.append)
        self.operations.unlock(SECRET, 0, "a test")
        self.work = AuthorityWork(root, self.operations, self.deliver, None, lambda: self.now)

    def deliver(self, call: StatementCall) -> object:
        if not self.reachable or call.method == "rossec.revocationStatus":  # an older master
            raise NotDelivered("no master", call.hint)
        self.calls.append(call.method)
        (items,) = call.statement[:1]
        return [""] * len(items) if isinstance(items, list) else 1

    def invite(self, uses: int = 1) -> InvitationCode:
        expires = self.now + DAY
        return invite(self.home, "/fleet/*", uses, expires, "127.0.0.1:9", self.now, wildcard=False)

    def request(self, code: InvitationCode, name: str = "/fleet/a", metadata: bytes = b"") -> bytes:
        node, face = self._session(code)
        face.receive(node.join(asked(name), metadata))
        return face.request.to_bytes()

    def claim(self, code: InvitationCode, metadata: bytes) -> bytes:
        node, face = self._session(code)
        face.receive(node.claim(metadata))
        return face.claim.to_bytes()

    def _session(self, code: InvitationCode) -> tuple[NodeJoin, AuthorityJoin]:
        own, root = self.home.node().credentials(), self.home.anchor().certificate
        node = NodeJoin(code, fresh())
        face = AuthorityJoin(LiveIdentity(own.signer, own.chain, root), fresh())
        welcome = face.receive(node.hello())
        assert welcome is not None
        node.receive(welcome, self.now)
        return node, face

    def grants(self) -> int:
        store = self.home.store()
        try:
            return len(store.grants())
        finally:
            store.close()


@pytest.fixture
def working(tmp_path: Path) -> Working:
    return Working(tmp_path)


def test_a_node_joins_and_the_same_request_gets_the_same_answer(working: Working) -> None:
    request = working.request(working.invite())
    answer, name = working.work.join(request)
    assert name == "/fleet/a"
    assert isinstance(read(answer), Issued)
    assert working.work.join(request) == (answer, name)
    assert working.audit[-1].startswith("signs a certificate of /fleet/a")
    assert working.audit[-1].endswith(", for a node that joins")


def test_a_claim_is_answered_for_an_invitation_that_is_proved(working: Working) -> None:
    code = working.invite()
    claim = JoinClaim.from_bytes(working.claim(code, b"<node/>"))
    assert working.work.allowed_pattern(claim) == "/fleet/*"
    forged = replace(claim, metadata=b"<other/>")
    assert working.work.allowed_pattern(forged) == RefusedMessage(RefuseReason.REFUSED)
    request = JoinRequest.from_bytes(working.request(code))
    assert not working.work.was_issued(request)
    working.work.join(request.to_bytes())
    assert working.work.was_issued(request)


def test_what_is_no_request_changes_nothing(working: Working) -> None:
    lines = len(working.audit)
    with pytest.raises(EnrollmentMessageRefused):
        working.work.join(b"x" * 10)
    request = JoinRequest.from_bytes(working.request(working.invite()))
    forged = JoinRequest(request.invitation, b"t" * 32, request.name, request.csr, request.proof).to_bytes()
    answer, name = working.work.join(forged)
    assert (read(answer), name) == (RefusedMessage(RefuseReason.REFUSED), None)
    assert len(working.audit) == lines, "nothing was signed"


def test_joins_wait_while_it_is_locked(working: Working) -> None:
    request = working.request(working.invite())
    working.operations.held.lock()
    answer, name = working.work.join(request)
    assert (read(answer), name) == (WaitingMessage(WaitReason.LOCKED), None)
    working.operations.unlock(SECRET, 0, "a test")
    assert working.work.join(request)[1] == "/fleet/a"


def test_a_node_gets_what_the_policy_gives_it(working: Working) -> None:
    (working.home.path / "policy.yaml").write_text(POLICY)
    working.work.join(working.request(working.invite()))
    working.work.apply(["/fleet/b"])
    assert working.grants() == 0
    working.work.apply(["/fleet/a"])
    assert working.grants() == 1
    assert working.audit[-1].endswith(", for the policy, which it applies")
    assert "rossec.depositGrants" in working.calls
    working.work.apply()
    assert working.grants() == 1, "applying again changes nothing"


@pytest.mark.parametrize(
    ("give", "said"),
    [("apply", "the policy is not applied: "), ("grant_outright", "/fleet/b has no grants yet: ")],
)
def test_a_node_that_needs_too_many_grants_keeps_no_other_from_its_own(
    working: Working, caplog: pytest.LogCaptureFixture, give: str, said: str
) -> None:
    many = ", ".join(f"/s{number}" for number in range(65 * 64))
    greedy = f"  - {{id: b, who: /fleet/b, allow: {{call: [{many}]}}}}\n"
    (working.home.path / "policy.yaml").write_text(POLICY + greedy)
    code, names = working.invite(3), ["/fleet/a", "/fleet/b", "/fleet/c"]
    for name in names:
        working.work.join(working.request(code, name))
    getattr(working.work, give)(names)
    assert working.grants() == 2
    assert caplog.text.count(f"{said}/fleet/b would need") == 1


def test_a_node_that_joins_gets_its_grants_without_the_policy_being_applied(
    working: Working, caplog: pytest.LogCaptureFixture
) -> None:
    working.work.join(working.request(working.invite()))
    working.work.grant_outright(["/fleet/a"])
    assert working.grants() == 0
    (working.home.path / "policy.yaml").write_text(POLICY)
    working.work.grant_outright(["/fleet/a"])
    assert working.grants() == 1
    (working.home.path / "policy.yaml").write_text("rules: x")
    working.work.grant_outright(["/fleet/a"])
    assert "/fleet/a has no grants yet: " in caplog.text


def test_a_right_that_the_policy_takes_back_is_revoked_in_the_next_round(working: Working) -> None:
    path = working.home.path / "policy.yaml"
    path.write_text(POLICY)
    working.work.join(working.request(working.invite()))
    working.work.apply(["/fleet/a"])
    path.write_text(POLICY.replace("/fleet/*", "/other/*"))
    working.work.apply()
    assert "rossec.updateRevocations" in working.calls


def test_grants_are_renewed_at_two_thirds(working: Working) -> None:
    (working.home.path / "policy.yaml").write_text(POLICY)
    working.work.join(working.request(working.invite()))
    working.work.apply(["/fleet/a"])
    working.now += 3 * DAY
    working.work.apply()
    assert working.grants() == 1
    working.now += 2 * DAY
    working.work.apply()
    assert working.grants() == 2


def test_a_policy_that_cannot_be_used_is_logged(working: Working, caplog: pytest.LogCaptureFixture) -> None:
    working.work.apply()
    assert "the policy is not applied: " in caplog.text
    assert working.grants() == 0


def test_while_it_is_locked_nothing_is_tried(working: Working, caplog: pytest.LogCaptureFixture) -> None:
    working.operations.held.lock()
    working.work.apply()
    working.work.maintain()
    assert (working.calls, caplog.text) == ([], "")


def test_its_own_identity_and_list_are_renewed_long_before_they_expire(working: Working) -> None:
    before = working.home.node().identity(NOW).not_after
    working.now += 300 * DAY
    working.work.maintain()
    assert working.home.node().identity(working.now).not_after > before
    assert "rossec.updateRevocations" in working.calls
    assert any(line.endswith(", for its own maintenance") for line in working.audit)


def test_a_master_out_of_reach_is_tried_again(working: Working, caplog: pytest.LogCaptureFixture) -> None:
    (working.home.path / "policy.yaml").write_text(POLICY)
    working.work.join(working.request(working.invite()))
    working.reachable = False
    working.work.apply()
    working.work.maintain()
    assert "no master" in caplog.text
    assert working.grants() == 1, "it is signed and recorded all the same"
    working.reachable = True
    working.work.maintain()
    assert "rossec.depositGrants" in working.calls


def test_a_list_reaches_a_master_that_was_out_of_reach(working: Working) -> None:
    path = working.home.path / "policy.yaml"
    path.write_text(POLICY)
    working.work.join(working.request(working.invite()))
    working.work.apply(["/fleet/a"])
    working.work.maintain()
    working.reachable = False
    path.write_text(POLICY.replace("/fleet/*", "/other/*"))
    working.work.apply()
    working.work.maintain()
    working.reachable = True
    working.calls.clear()
    working.work.maintain()
    assert "rossec.updateRevocations" in working.calls, "it would revoke nothing otherwise"
    working.calls.clear()
    working.work.maintain()
    assert "rossec.updateRevocations" not in working.calls, "the master has it"


def test_a_policy_that_could_not_be_applied_is_tried_in_the_next_round(
    working: Working, monkeypatch: pytest.MonkeyPatch
) -> None:
    (working.home.path / "policy.yaml").write_text(POLICY)
    working.work.join(working.request(working.invite()))

    def busy(*_: object, **__: object) -> None:
        raise StoreError("another command uses the record", "try again")

    with monkeypatch.context() as patch:
        patch.setattr(PolicyWork, "plan", busy)
        working.work.apply_if_changed()
    assert working.grants() == 0
    working.work.apply_if_changed()
    assert working.grants() == 1


def test_a_node_of_this_home_gets_a_file(working: Working) -> None:
    (working.home.path / "policy.yaml").write_text(POLICY)
    node = NodeHome.of(working.root, "/fleet/a")
    answer, _ = working.work.join(working.request(working.invite()))
    assert isinstance(read(answer), Issued)
    node.path.mkdir(parents=True, mode=0o700)
    working.work.apply(["/fleet/a"])
    assert len(node.grant_files()) == 1
    assert from_pem((working.home.path / "ca.pem").read_bytes())


def test_a_round_plans_only_when_something_changed_or_may_be_due(
    working: Working, monkeypatch: pytest.MonkeyPatch
) -> None:
    rounds = list[int]()
    monkeypatch.setattr(working.work, "apply", lambda: rounds.append(working.now))
    path = working.home.path / "policy.yaml"
    path.write_text(POLICY)
    for _ in range(3):
        working.work.apply_if_changed()
    assert len(rounds) == 1
    path.write_text(POLICY + "# changed")
    working.work.apply_if_changed()
    assert len(rounds) == 2
    working.work.join(working.request(working.invite()))
    working.work.apply_if_changed()
    working.work.apply_if_changed()
    assert len(rounds) == 3
    working.now += 600
    working.work.apply_if_changed()
    assert len(rounds) == 4


def test_a_round_while_it_is_locked_is_made_up_for(working: Working, monkeypatch: pytest.MonkeyPatch) -> None:
    (working.home.path / "policy.yaml").write_text(POLICY)
    working.work.join(working.request(working.invite()))
    working.operations.held.lock()
    working.work.apply_if_changed()
    assert working.grants() == 0
    working.operations.unlock(SECRET, 0, "a test")
    working.work.apply_if_changed()
    assert working.grants() == 1


def test_a_round_without_a_policy_is_logged(working: Working, caplog: pytest.LogCaptureFixture) -> None:
    working.work.apply_if_changed()
    assert "the policy is not applied: " in caplog.text


def test_a_list_of_domains_is_signed_and_delivered_in_a_round(working: Working) -> None:
    working.work.maintain()
    assert "rossec.updateDomains" not in working.calls
    with closing(working.home.store()) as store:
        store.domains.accept(foreign(Site.create("hospital.example")), NOW)
    for _ in range(2):
        working.work.maintain()
    assert working.calls.count("rossec.updateDomains") == 1
    assert any(line.startswith("signs a list of domains") for line in working.audit)
    working.now += 8 * DAY
    working.work.maintain()
    assert working.calls.count("rossec.updateDomains") == 2
