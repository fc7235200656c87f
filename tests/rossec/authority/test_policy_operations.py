"""What the authority does by its policy: what is told to the master, and in which order."""

import secrets
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from ca.errors import HintedError
from ca.revocation.trust_status import open_statement
from grants import document
from grants.model import Right
from grants.request import GrantRequest, RequestedRight, sign_request
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import PolicyFile, read_policy
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.errors import ConfigurationError, NotDelivered
from rossec.home import NodeHome

NOW, DAY = 1_800_000_000, 86_400
SECRET = "four random words here"
POLICY = """rossec: 1
robot: r
rules:
  - {id: a, who: "*", allow: {subscribe: [/pose]}}
  - {id: b, who: /here, allow: {publish: [/odom]}}
"""
PROMPT = """  - {id: p, who: /there, prompt: {call: [/lift, /door]}, lifetime: 1h}
"""
CHANGED = POLICY.replace("[/pose]}", "[/pose]}, lifetime: 1d")  # each grant is signed anew


class Office:
    """An authority with the node /here in its ROSSEC_HOME, and /there on another host."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.now = NOW
        self.calls: list[str] = []
        self.known: set[bytes] = set()
        self.answer: Callable[[bytes], str] = lambda _: ""
        self.reachable = True
        AuthorityHome.create(root, "home", SECRET, NOW)
        self.service = AuthorityService(root, lambda: SECRET, self._deliver, lambda: self.now)
        self.here = self.enroll(root, "/here")
        self.there = self.enroll(root / "other", "/there")
        self.write(POLICY)

    def enroll(self, root: Path, name: str) -> NodeHome:
        node = NodeHome.of(root, name)
        node.create_request("home")
        bundle = self.service.identities.issue(
            node.request(), 30 * DAY, replace_key=None, wildcard=False, source="a test"
        )
        node.install(bundle, self.now)
        return node

    def write(self, text: str) -> None:
        (self.root / "ca" / "policy.yaml").write_text(text)

    def _deliver(self, call: StatementCall) -> object:
        if not self.reachable:
            raise NotDelivered(f"no master for {call.what}", call.hint)
        if call.method == "rossec.revocationStatus":  # it has the newest list
            home = self.service.home
            newest = open_statement(home.revocation_list(), home.anchor().public_key)
            return {"list": f"{newest.number[0]}.{newest.number[1]}"}
        self.calls.append(call.method)
        (items, *_) = call.statement
        if not isinstance(items, list):
            return 0
        if call.method == "rossec.deliveryStates":
            return ["waiting" if item[:16] in self.known else "" for item in items]
        self.known.update(map(document.grant_id, items))
        return [self.answer(item) for item in items]

    def apply(self) -> list[str]:
        """What is reported."""
        said: list[str] = []
        plan = self.service.policy.plan(read_policy(self.root, None))
        self.service.policy.apply(plan, said.append)
        return said

    def asked(self, *names: str) -> PolicyFile:
        """The policy in force, by which /there asked to call the services `names`."""
        self.write(POLICY + PROMPT)
        policy = read_policy(self.root, None)
        wanted = tuple(RequestedRight(Right.CALL, name) for name in names)
        made = GrantRequest("home", "/there", self.now, secrets.token_bytes(16), wanted, "please")
        data = sign_request(self.there.credentials().signer, made)
        assert self.service.policy.collect_requests(policy, [data]) == []
        return policy

    def is_done(self) -> bool:
        return self.service.policy.plan(read_policy(self.root, None)).is_empty


@pytest.fixture
def office(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Office]:
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    made = Office(tmp_path / "office")
    with closing(made.service):
        yield made


def test_new_grants_are_deposited_and_stored(office: Office) -> None:
    assert office.apply() == ["signed: 3"]
    assert office.calls == ["rossec.depositGrants"]
    assert len(office.known) == 3
    assert len(office.here.grants()) == 2
    assert office.is_done()


def test_new_grants_are_delivered_before_the_old_are_revoked(office: Office) -> None:
    office.apply()
    office.calls.clear()
    office.write(CHANGED)
    assert office.apply() == ["signed: 2", "revoked: 2 (list 2)", "the master has the new list"]
    assert office.calls == ["rossec.deliveryStates", "rossec.depositGrants", "rossec.updateRevocations"]
    assert len(office.known) == 5


def test_without_a_master_all_is_signed_and_revoked_here(office: Office) -> None:
    office.reachable = False
    with pytest.raises(NotDelivered, match="no master for the grants"):
        office.apply()
    office.write(CHANGED)
    with pytest.raises(NotDelivered, match="no master for the list"):
        office.apply()
    assert office.is_done()
    office.reachable = True
    office.service.policy.complete()
    assert office.calls == ["rossec.deliveryStates", "rossec.depositGrants", "rossec.updateRevocations"]
    assert len(office.known) == 3


def test_nodes_of_this_home_need_no_master(office: Office) -> None:
    office.reachable = False
    office.write(POLICY.replace('"*"', "/here"))
    assert office.apply() == ["signed: 2"]
    assert len(office.here.grants()) == 2


def test_a_file_that_is_missing_is_written_again(office: Office) -> None:
    office.apply()
    for path in office.here.grant_files():
        path.unlink()
    office.service.policy.complete()
    assert len(office.here.grants()) == 2
    office.now += 8 * DAY  # what has ended is of no use
    for path in office.here.grant_files():
        path.unlink()
    office.service.policy.complete()
    assert office.here.grants() == []


def test_before_a_policy_was_applied_there_is_nothing_to_complete(office: Office) -> None:
    office.service.policy.complete()
    assert office.calls == []


@pytest.mark.parametrize("error", [ConfigurationError("expired"), OSError(28, "full")])
def test_a_delivery_that_fails_holds_no_revocation_back(office: Office, error: Exception) -> None:
    office.apply()
    office.write(CHANGED)

    def fail(_: bytes) -> str:
        raise error

    office.answer = fail
    with pytest.raises(type(error)):
        office.apply()
    assert office.calls[-1] == "rossec.updateRevocations"
    assert office.is_done()


def test_a_plan_that_only_revokes_is_not_carried_out_by_another_policy(office: Office) -> None:
    office.apply()
    office.write("rossec: 1\nrobot: r\nrules: []\n")
    plan = office.service.policy.plan(read_policy(office.root, None))
    office.write(POLICY)
    with pytest.raises(ConfigurationError, match="changed"):
        office.service.policy.apply(plan)
    assert office.is_done(), "nothing was revoked"


def test_a_new_identity_gets_what_the_policy_gives_it(office: Office) -> None:
    (signed,) = office.service.policy.grant_outright("/there")
    assert signed[0].subject == "/there"
    assert office.service.policy.grant_outright("/there") == []
    assert office.calls == []  # delivering is a step of its own
    office.write("rossec: 1\n")
    with pytest.raises(HintedError):
        office.service.policy.grant_outright("/here")


def test_a_new_identity_gets_nothing_by_a_policy_whose_tests_do_not_hold(office: Office) -> None:
    """`apply` refused the file, and the next enrollment put it in force for its node."""
    text = (office.root / "ca" / "policy.yaml").read_text()
    office.write(f"{text}tests: [{{who: /there, may_not: {{subscribe: /pose}}}}]\n")
    with pytest.raises(HintedError, match="the test does not hold"):
        office.service.policy.grant_outright("/there")
    office.write(f"{text}tests: [{{who: /there, may: {{subscribe: /pose}}}}]\n")
    assert len(office.service.policy.grant_outright("/there")) == 1


def test_what_a_new_identity_gets_is_in_the_policy_that_was_given(office: Office, tmp_path: Path) -> None:
    (tmp_path / "given.yaml").write_text("rossec: 1\nrobot: r\nrules: []\n")
    assert office.service.policy.grant_outright("/there", place=tmp_path / "given.yaml") == []
    assert office.service.policy.grant_outright("/there", place=tmp_path / "none.yaml") == []
    assert len(office.service.policy.grant_outright("/there")) == 1
    (office.root / "ca" / "policy.yaml").unlink()
    assert office.service.policy.grant_outright("/here") == []


def test_what_the_master_renews_is_not_signed_again(office: Office) -> None:
    office.write(POLICY.replace("[/pose]}}", "[/pose]}, renew_until: 60d}"))
    office.apply()
    master = office.enroll(office.root / "other", "/master")
    office.now = NOW + 10 * DAY
    plan = office.service.policy.plan(read_policy(office.root, None))
    assert plan.signs == 3

    def renews() -> tuple[int, bool]:
        plan = office.service.policy.plan(read_policy(office.root, None))
        return plan.signs, plan.moment.renews

    delegation, call = office.service.grants.delegate(DAY * 30, 3600)
    assert renews() == (3, False), "it was signed, but the master does not have it"
    office.reachable = False
    with pytest.raises(NotDelivered):
        office.service.grants.deliver_delegation(delegation, call)
    assert renews() == (3, False)
    office.reachable = True
    office.service.grants.deliver_delegation(delegation, call)
    assert renews() == (1, True)
    office.enroll(office.root / "other", "/master/kitchen")
    assert renews() == (3, False), "a node that asks the other master gets no renewal"
    office.service.grants.deliver_delegation(
        *office.service.grants.delegate(DAY * 3, 3600, "/master/kitchen")
    )
    assert renews() == (1, True)
    office.now += 4 * DAY
    assert renews() == (3, False), "the delegation of one of them has ended"
    office.now -= 4 * DAY
    office.service.grants.revoke_delegations("test")
    assert not office.service.policy.plan(read_policy(office.root, None)).moment.renews
    assert master.path.is_dir()


def test_options_reach_the_plan(office: Office) -> None:
    policy = PolicyFile.read(office.root / "ca" / "policy.yaml")
    plan = office.service.policy.plan(policy, ["/here"], renew_due=True, prune=True)
    assert [node.subject.name for node in plan.nodes] == ["/here"]
    assert (plan.moment.renew_due, plan.options.prune) == (True, True)


def test_a_person_approves_what_waits_and_the_policy_decides_the_rest(office: Office) -> None:
    policy = office.asked("/lift", "/window")
    decided = office.service.policy.decide(policy)
    assert (decided.grants, decided.allowed, decided.waiting) == ([], 0, 1)
    assert [each.stored.requested.pattern for each in decided.denied] == ["/window"]
    (waiting,) = office.service.policy.pending(policy)
    beginning = waiting.stored.request.id.hex()[:8]
    ((draft, _),) = office.service.policy.approve(policy, beginning, lambda verdict: verdict)
    assert [permission.pattern for permission in draft.permissions] == ["/lift"]
    assert office.service.policy.pending(policy) == []
    assert office.service.policy.decide(policy) == ([], 0, 0, [])


def test_what_the_policy_allows_is_signed_when_it_is_asked_for(office: Office) -> None:
    office.asked("/lift")
    office.write(POLICY + PROMPT.replace("prompt", "allow"))
    decided = office.service.policy.decide(read_policy(office.root, None))
    assert (len(decided.grants), decided.allowed, decided.waiting) == (1, 1, 0)


def test_nothing_asked_for_is_signed_by_a_policy_whose_tests_do_not_hold(office: Office) -> None:
    office.asked("/lift")
    allowing = POLICY + PROMPT.replace("prompt", "allow")
    office.write(f"{allowing}tests: [{{who: /there, may_not: {{call: /lift}}}}]\n")
    with pytest.raises(HintedError, match="the test does not hold"):
        office.service.policy.decide(read_policy(office.root, None))
    office.write(allowing)
    assert len(office.service.policy.decide(read_policy(office.root, None)).grants) == 1


def test_a_person_denies_all_rights_of_a_request(office: Office) -> None:
    policy = office.asked("/lift", "/door")
    (first, second) = office.service.policy.pending(policy)
    denied = office.service.policy.deny(policy, first.stored.request.id.hex())
    assert denied == [first, second]
    assert office.service.policy.pending(policy) == []


def test_an_invalid_file_in_the_inbox_is_reported(office: Office) -> None:
    inbox = office.root / "ca" / "inbox"
    inbox.mkdir(exist_ok=True)
    (inbox / "bad.request").write_bytes(b"nonsense")
    (error,) = office.service.policy.collect_requests(read_policy(office.root, None))
    assert error.startswith("bad.request: ")


def test_opting_out_changes_the_policy_and_revokes_what_shows_it(office: Office) -> None:
    office.apply()
    opted_out = office.service.policy.opt_out(read_policy(office.root, None), "/pose")
    assert opted_out.rule == "opt-out-pose"
    revoked = office.service.policy.revoke_opted_out(opted_out)
    assert {grant.subject for grant, _ in revoked} == {"/here", "/there"}
    assert office.service.policy.revoke_opted_out(opted_out) == []


def test_opting_out_of_a_node_that_is_enrolled_needs_no_option(office: Office) -> None:
    office.apply()
    opted_out = office.service.policy.opt_out(read_policy(office.root, None), "/there")
    ((grant, _),) = office.service.policy.revoke_opted_out(opted_out)
    assert grant.subject == "/there"
