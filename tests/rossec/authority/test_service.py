"""The authority for its users: nothing is printed or asked, only the two callables are called."""

import secrets
import subprocess
import sys
from pathlib import Path

import pytest

from ca.certificates import build_intermediate_request, from_pem
from ca.errors import PassphraseRefused, StoreError
from ca.keys import private_keys
from ca.keys.signing import KeySigner
from ca.revocation.lists import open_list
from ca.store.values import RequestState, open_head
from ca.svid import check_request
from grants import document
from grants.errors import GrantForged
from grants.model import Permission, Right
from grants.renewal import MIN_TICKET, open_delegation
from grants.request import GrantRequest, RequestedRight, sign_request
from rossec.authority.home import OWN_LIFETIME, AuthorityHome
from rossec.authority.policyfile import PolicyFile
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.errors import AuthorityLocked, ConfigurationError, NotDelivered
from rossec.home import NodeHome
from rossec.ros.names import MASTER
from tests.support import refusal_texts
from tests.support.keyservice import running_service

NOW, DAY = 1_800_000_000, 86_400
SECRET = "four random words here"
PUBLISH = (Permission("/p", Right.PUBLISH),)
POLICY = """rossec: 1
robot: r
types: {/pose: geometry_msgs/PoseStamped}
rules:
  - {id: a, who: /robot, allow: {subscribe: [/pose]}}
  - {id: p, who: "*", prompt: {call: [/lift]}}
"""
POSE, LIFT = RequestedRight(Right.SUBSCRIBE, "/pose"), RequestedRight(Right.CALL, "/lift")


class Office:
    """An authority with the node /robot, an operator, and a master that can be out of reach."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.now = NOW
        self.asked = 0
        self.secret = SECRET
        self.calls: list[StatementCall] = []
        self.reachable = True
        self.home = AuthorityHome.create(root, "home", SECRET, NOW)
        self.service = self.opened()
        self.robot = self.enroll("/robot")

    def opened(self) -> AuthorityService:
        return AuthorityService(self.root, self._passphrase, self._deliver, lambda: self.now)

    def _passphrase(self) -> str:
        self.asked += 1
        return self.secret

    def _deliver(self, call: StatementCall) -> None:
        if not self.reachable:
            raise NotDelivered("no master", call.hint)
        self.calls.append(call)

    def csr(self, name: str) -> bytes:
        node = NodeHome.of(self.root, name)
        node.create_request("home")
        return node.request()

    def issue(self, csr: bytes, replace_key: str | None = None) -> bytes:
        return self.service.identities.issue(
            csr, DAY, replace_key=replace_key, wildcard=False, source="a test"
        )

    def enroll(self, name: str) -> NodeHome:
        node = NodeHome.of(self.root, name)
        node.install(self.issue(self.csr(name)), NOW)
        return node

    def revoked(self) -> frozenset[bytes]:
        return open_list(self.home.revocation_list(), self.home.anchor().public_key).entries

    def policy(self) -> PolicyFile:
        path = self.root / "ca" / "policy.yaml"
        if not path.exists():
            path.write_text(POLICY)
        return PolicyFile.read(path)

    def request(self, *rights: RequestedRight, name: str = "/robot") -> bytes:
        asked = GrantRequest("home", name, NOW, secrets.token_bytes(16), rights, "please")
        return sign_request(self.robot.credentials().signer, asked)


@pytest.fixture
def office(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Office:
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    return Office(tmp_path / "office")


def test_neither_click_nor_asyncio_is_imported() -> None:
    unwanted = "{'click', 'asyncio', 'rossec.authority.grant_queue'}"
    program = f"import sys, rossec.authority.service; sys.exit(bool({unwanted} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", program], check=True)


def test_the_passphrase_is_asked_for_once(office: Office) -> None:
    office.service.close()
    office.asked = 0
    office.secret = "wrong"
    with pytest.raises(PassphraseRefused):
        office.service.sign_head()
    office.secret = SECRET
    head = office.service.sign_head()
    office.service.sign_head()
    assert office.asked == 2
    assert open_head(head, office.home.own_key()).size > 0
    office.service.close()
    office.service.close()
    office.service.unlock()
    assert office.asked == 3


def test_a_running_service_is_asked_instead_of_the_operator(office: Office) -> None:
    office.service.close()
    with running_service(office.home) as running:
        with pytest.raises(AuthorityLocked):
            office.service.sign_head()
        running.operations.unlock(SECRET, 60, "a test")
        office.service.sign_head()
        office.service.close()
    assert office.asked == 1, "for /robot, before it ran"
    assert [line.partition(",")[0] for line in running.audit[1:]] == ["signs a head of the log"]
    office.service.sign_head()
    assert office.asked == 2


def test_without_an_authority_nobody_is_asked(tmp_path: Path) -> None:
    service = AuthorityService(tmp_path, lambda: pytest.fail("asked"), lambda _: None)
    with pytest.raises(ConfigurationError, match="there is no authority"):
        service.unlock()


def test_a_request_for_an_identity_is_approved_or_denied(office: Office) -> None:
    service, asked = office.service, office.csr("/camera")
    row = service.identities.add_request(check_request(asked, "home"), asked, "a test")
    assert (row.state, row.name) == (RequestState.PENDING, "/camera")
    assert service.identities.request(row.digest.hex()[:9]) == row
    office.issue(row.der)
    again = service.identities.add_request(check_request(asked, "home"), asked, "a test")
    assert (again.state, again.digest) == (RequestState.ISSUED, row.digest)
    other = office.csr("/other")
    row = service.identities.add_request(check_request(other, "home"), other, "a test")
    service.identities.deny_request(row, "unknown")
    assert service.identities.request(row.digest.hex()).reason == "unknown"
    with pytest.raises(StoreError, match="is denied and cannot be issued"):
        office.issue(other)
    with pytest.raises(ConfigurationError, match="'xx' is not a request id"):
        service.identities.request("xx")


def test_a_replaced_key_is_to_be_published(office: Office) -> None:
    service, old = office.service, office.robot.identity(NOW).thumbprint
    office.robot.path.rename(office.root / "lost")
    asked = office.csr("/robot")
    with pytest.raises(StoreError, match=refusal_texts.KEY_CHANGED):
        office.issue(asked)
    assert (service.has_revoked, service.has_signed_list) == (False, False)
    office.issue(asked, "/robot")
    assert service.has_revoked
    assert service.has_signed_list
    assert office.revoked() == {old}


def test_a_list_that_was_due_is_to_be_published(office: Office) -> None:
    assert not office.opened().has_signed_list
    office.now = NOW + 8 * DAY
    office.issue(office.csr("/camera"))
    assert office.service.has_signed_list
    assert not office.service.has_revoked


def test_identities_are_renewed(office: Office) -> None:
    office.now = NOW + DAY // 2
    bundle = office.service.identities.renew("/robot", DAY)
    assert office.robot.install(bundle, office.now).not_after == office.now + DAY
    assert office.service.identities.renew_own_node() == office.now + OWN_LIFETIME
    with pytest.raises(ConfigurationError, match="is an intermediate"):
        office.service.identities.renew("intermediate/0123", DAY)
    with pytest.raises(StoreError, match="/nobody has no valid identity"):
        office.service.identities.renew("/nobody", DAY)


def test_an_intermediate_is_signed_and_its_identities_imported(office: Office) -> None:
    request = build_intermediate_request(KeySigner(private_keys.generate()), "home")
    name, bundle = office.service.identities.sign_intermediate(request, may_enroll=True, lifetime=DAY)
    assert name.startswith("intermediate/")
    assert len(from_pem(bundle)) == 2
    identity, new = office.service.identities.import_bundle((office.robot.path / "node.pem").read_bytes())
    assert (identity.name, new) == ("/robot", False)


def test_a_revocation_is_recorded_and_then_published(office: Office) -> None:
    listed, count = office.service.identities.revoke("/robot", "stolen")
    assert (listed.seq, count) == (2, 1)
    assert office.service.has_revoked
    office.reachable = False
    with pytest.raises(NotDelivered) as caught:
        office.service.publish()
    assert "rossec ca publish" in caught.value.hint
    assert office.revoked() == listed.entries != frozenset()
    office.reachable = True
    office.service.publish()
    (call,) = office.calls
    assert call.node.name == "/ca"
    assert (call.method, call.what, call.note) == ("rossec.updateRevocations", "the list", "")
    assert call.statement == (office.home.revocation_list(),)
    with pytest.raises(StoreError, match="is revoked"):
        office.issue(office.robot.request())


def test_a_tree_is_published_with_its_entries(office: Office, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    office.service.identities.revoke("/robot", "stolen")
    office.service.publish()
    (call,) = office.calls
    assert call.method == "rossec.updateRevocationTree"
    assert call.statement == (office.home.revocation_list(), office.home.newest_statement()[1])


def test_an_old_list_is_noted_and_an_expired_one_refused(office: Office) -> None:
    office.now = NOW + 84 * DAY
    office.service.publish()
    assert office.calls[-1].note.endswith("renew it with: rossec ca refresh")
    office.now = NOW + 90 * DAY
    with pytest.raises(ConfigurationError, match="the revocation list expired"):
        office.service.publish()
    office.service.complete_list()
    office.service.publish()
    assert office.calls[-1].note == ""


def test_a_refresh_renews_the_own_node_when_it_is_due(office: Office) -> None:
    listed, renewed = office.service.refresh()
    assert (listed.seq, renewed) == (2, None)
    office.now = NOW + OWN_LIFETIME + DAY
    office.service.complete_list()
    with pytest.raises(ConfigurationError, match="the identity of /ca has expired") as caught:
        office.service.publish()
    assert caught.value.hint == "renew it: rossec ca renew /ca"
    assert office.calls == []
    assert office.service.refresh()[1] == office.now + OWN_LIFETIME
    office.service.publish()


def test_a_grant_is_signed_and_revoked(office: Office) -> None:
    draft, data = office.service.grants.sign("/robot", PUBLISH, DAY, 3 * DAY)
    grant = document.open_grant(data, office.home.anchor().public_key, NOW, domain="home")
    assert (grant.expires, grant.cap, grant.holder) == (NOW + DAY, NOW + 3 * DAY, draft.holder)
    assert office.home.store().grants()[-1].data == data
    with pytest.raises(StoreError, match="/nobody has no valid identity"):
        office.service.grants.sign("/nobody", PUBLISH, DAY)
    office.service.grants.sign("/robot", PUBLISH, DAY)
    for beginning in ("", "xx"):
        with pytest.raises(ConfigurationError, match="no grant begins"):
            office.service.grants.revoke(beginning, "")
    listed, entry = office.service.grants.revoke(grant.id.hex()[:12].upper(), "over")
    assert listed.entries == {entry} == {grant.id}


def test_the_policy_decides_or_a_person(office: Office) -> None:
    policy, service = office.policy(), office.opened()
    assert service.policy.collect_requests(policy) == []
    assert service.policy.decide(policy) == ([], 0, 0, [])
    asked = office.asked
    door = RequestedRight(Right.CALL, "/door")
    service.policy.collect_requests(policy, [office.request(POSE, LIFT, door)])
    (pending,) = service.policy.pending(policy)
    assert pending.stored.requested == LIFT
    assert office.asked == asked  # nothing needed the key
    decided = service.policy.decide(policy)
    assert decided[1:] == (1, 1, [])  # the third was denied when they were shown
    ((draft, data),) = decided.grants
    assert office.home.store().grants()[-1].data == data
    assert [item.pattern for item in draft.permissions] == ["/pose"]
    with pytest.raises(ConfigurationError, match="no open request begins"):
        service.policy.approve(policy, "xx", lambda verdict: verdict)
    request_id = pending.stored.request.id.hex()
    ((draft, _),) = service.policy.approve(policy, request_id[:8], lambda verdict: verdict)
    assert [item.pattern for item in draft.permissions] == ["/lift"]
    assert service.policy.pending(policy) == []
    with pytest.raises(GrantForged):
        service.policy.collect_requests(policy, [office.request(LIFT)[:-1] + b"x"])


def test_a_person_denies_without_the_key(office: Office) -> None:
    policy, service = office.policy(), office.opened()
    asked = office.asked
    service.policy.collect_requests(policy, [office.request(LIFT)])
    (pending,) = service.policy.pending(policy)
    (denied,) = service.policy.deny(policy, pending.stored.request.id.hex())
    assert denied == pending
    assert service.policy.pending(policy) == []
    assert office.asked == asked


def test_an_opt_out_revokes_what_is_shown(office: Office) -> None:
    shown = (Permission("/pose", Right.SUBSCRIBE), *PUBLISH)
    _, data = office.service.grants.sign("/robot", shown, DAY)
    opted_out = office.service.policy.opt_out(office.policy(), "/pose")
    assert (opted_out.rule, opted_out.is_node) == ("opt-out-pose", False)
    ((grant, reissued),) = office.service.policy.revoke_opted_out(opted_out)
    assert grant.id == document.grant_id(data)
    assert reissued is not None
    assert [item.pattern for item in document.peek(reissued).permissions] == ["/p"]
    assert office.service.policy.opt_out(office.policy(), "/robot").is_node


def test_a_delegation_is_recorded_delivered_and_revoked(office: Office) -> None:
    with pytest.raises(StoreError, match="/master has no valid identity"):
        office.service.grants.delegate(DAY, MIN_TICKET)
    holder = office.enroll(MASTER).identity(NOW).thumbprint
    delegation, call = office.service.grants.delegate(DAY, MIN_TICKET)
    assert (delegation.holder, delegation.max_ttl) == (holder, MIN_TICKET)
    (path,) = (office.home.path / "delegations").iterdir()
    assert call.statement == (path.read_bytes(),)
    assert open_delegation(path.read_bytes(), office.home.own_key()) == delegation
    assert str(path.parent) in call.hint
    office.service.deliver(call)
    assert office.calls == [call]
    listed, count = office.service.grants.revoke_delegations("withdrawn")
    assert (listed.entries, count) == (frozenset({delegation.id}), 1)
