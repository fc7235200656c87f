from dataclasses import replace
from pathlib import Path

import pytest

from ca.enrollment.invitation import sign_proof
from ca.enrollment.join import RefusedMessage, RefuseReason, WaitingMessage, WaitReason
from ca.errors import RecordUnusable
from ca.store.values import RequestState
from ca.svid import check_request
from rossec.authority.invitations import MAX_WAITING, allowed_pattern, join, join_locked
from tests.support.joining import HOUR, JoinSite, asked, issued, refusal
from tests.support.pki import NOW, new_signer

LOCKED, PERSON = WaitingMessage(WaitReason.LOCKED), WaitingMessage(WaitReason.PERSON)


@pytest.fixture
def home(tmp_path: Path) -> JoinSite:
    return JoinSite(tmp_path / "site")


def uses(home: JoinSite, code_id: bytes) -> list[str]:
    return [use.name for use in home.store.invitations.uses(code_id)]


def test_a_node_joins_and_the_use_is_recorded(home: JoinSite) -> None:
    code, key = home.invite(), new_signer()
    identity = home.authority.verify(issued(home.join(code, signer=key)), NOW)
    assert (identity.name, identity.wildcard) == ("/fleet/robot07", False)
    [use] = home.store.invitations.uses(code.id)
    assert (use.name, use.thumbprint) == (identity.name, identity.thumbprint)
    row = home.store.requests.all()[-1]
    assert row.state is RequestState.ISSUED
    assert row.source == f"invitation {code.id.hex()[:8]}"
    home.store.log.audit(home.site.anchor.public_key)


def test_the_same_request_gets_the_same_answer_and_uses_once(home: JoinSite) -> None:
    code, csr = home.invite(), asked("/fleet/robot07")
    first = join(home.authority, home.request(code, csr), NOW)
    again = join(home.authority, home.request(code, csr), NOW + 2 * HOUR)
    assert first == again
    assert issued(first)
    assert uses(home, code.id) == ["/fleet/robot07"]
    home.store.invitations.end(code.id, "stolen", NOW)
    assert join(home.authority, home.request(code, csr), NOW) == first


def test_an_answered_request_whose_identity_was_revoked_is_denied(home: JoinSite) -> None:
    code, csr = home.invite(), asked("/fleet/robot07")
    issued(join(home.authority, home.request(code, csr), NOW))
    home.authority.revoke_identity("/fleet/robot07", "stolen", NOW)
    assert refusal(join(home.authority, home.request(code, csr), NOW)) is RefuseReason.DENIED


def test_an_answered_request_whose_identity_has_expired_is_denied(home: JoinSite) -> None:
    code, csr = home.invite(), asked("/fleet/robot07")
    issued(join(home.authority, home.request(code, csr), NOW))
    much_later = NOW + 60 * 86400
    request = home.request(code, csr)
    assert refusal(join(home.authority, request, much_later)) is RefuseReason.DENIED


def test_the_uses_are_counted(home: JoinSite) -> None:
    code = home.invite(uses=2)
    for name in ("/fleet/a", "/fleet/b"):
        issued(home.join(code, name))
    assert refusal(home.join(code, "/fleet/c")) is RefuseReason.ENDED
    assert uses(home, code.id) == ["/fleet/a", "/fleet/b"]
    assert home.store.identities.by_name("/fleet/c") == []


@pytest.mark.parametrize("now", [NOW + HOUR + 1, NOW])
def test_an_invitation_that_is_over(home: JoinSite, now: int) -> None:
    code = home.invite()
    if now == NOW:
        home.store.invitations.end(code.id, "stolen", NOW)
    assert refusal(home.join(code, now=now)) is RefuseReason.ENDED
    assert home.store.identities.by_name("/fleet/robot07") == []


def test_an_unknown_invitation_and_a_wrong_proof_are_the_same(home: JoinSite) -> None:
    code, csr = home.invite(), asked("/fleet/a")
    request = home.request(code, csr)
    unknown = replace(request, invitation=bytes(32))
    wrong = replace(request, proof=request.proof[:-1] + bytes([request.proof[-1] ^ 1]))
    for bad in (unknown, wrong, replace(request, name="/fleet/b"), replace(request, csr=b"x")):
        assert refusal(join(home.authority, bad, NOW)) is RefuseReason.REFUSED
        assert refusal(join_locked(home.store, bad, NOW)) is RefuseReason.REFUSED
    assert uses(home, code.id) == []


@pytest.mark.parametrize("name", ["/other/a", "/fleet", "/fleet/a/b", "/fleetx/a"])
def test_a_name_outside_of_the_pattern(home: JoinSite, name: str) -> None:
    assert refusal(home.join(home.invite(), name)) is RefuseReason.NAME


@pytest.mark.parametrize("name", ["/ca", "/master/kitchen", "/gateway", "/gateway/attic"])
@pytest.mark.parametrize("pattern", ["/**", "/*", None])
def test_reserved_names_never(home: JoinSite, name: str, pattern: str | None) -> None:
    code = home.invite(pattern or name)
    assert refusal(home.join(code, name)) is RefuseReason.NAME


def test_another_request_than_the_one_proved(home: JoinSite) -> None:
    """The holder of the code signs whatever it likes: the name it proved is the CSR's, or none."""
    code = home.invite()
    request = home.request(code, asked("/fleet/a"))
    for csr, name in ((asked("/fleet/a"), "/fleet/b"), (b"rubbish", "/fleet/a")):
        proof = sign_proof(code.signer, request.transcript, csr, name)
        lying = replace(request, csr=csr, name=name, proof=proof)
        assert refusal(join(home.authority, lying, NOW)) is RefuseReason.REQUEST


def test_identities_for_anonymous_nodes_only_if_the_invitation_says_so(home: JoinSite) -> None:
    code = home.invite("/rviz", wildcard=True)
    assert home.authority.verify(issued(home.join(code, "/rviz")), NOW).wildcard
    plain = home.invite("/fleet/*", 2)
    request = home.request(replace(plain, wildcard=True), asked("/fleet/a", wildcard=True))
    assert refusal(join(home.authority, request, NOW)) is RefuseReason.REQUEST


def test_a_name_that_an_anonymous_identity_covers(home: JoinSite) -> None:
    issued(home.join(home.invite("/fleet/rviz", wildcard=True), "/fleet/rviz"))
    assert refusal(home.join(home.invite(), "/fleet/rviz_1")) is RefuseReason.NAME


def test_a_known_name_with_another_key_waits_for_a_person(home: JoinSite) -> None:
    code = home.invite(uses=3)
    issued(home.join(code, "/fleet/a"))
    csr = asked("/fleet/a")
    assert join(home.authority, home.request(code, csr), NOW) == PERSON
    assert join(home.authority, home.request(code, csr), NOW) == PERSON
    assert uses(home, code.id) == ["/fleet/a"]
    [row] = home.store.requests.open()
    assert row.name == "/fleet/a"
    home.authority.issue(csr, NOW, replace_key="/fleet/a", source=row.source)
    assert issued(join(home.authority, home.request(code, csr), NOW))


@pytest.mark.parametrize("revoked", [True, False])
def test_a_name_whose_identity_has_ended_is_not_new(home: JoinSite, revoked: bool) -> None:
    code = home.invite(uses=3, lasts=90 * 86400)
    issued(home.join(code, "/fleet/a"))
    if revoked:
        home.authority.revoke_identity("/fleet/a", "stolen", NOW)
    later = NOW if revoked else NOW + 60 * 86400
    answer = join(home.authority, home.request(code, asked("/fleet/a")), later)
    assert answer == PERSON


def test_a_person_denies(home: JoinSite) -> None:
    code, csr = home.invite(uses=3), asked("/fleet/a")
    issued(home.join(code, "/fleet/a"))
    assert join(home.authority, home.request(code, csr), NOW) == PERSON
    [row] = home.store.requests.open()
    home.store.requests.deny(row.digest, NOW, "no")
    assert refusal(join(home.authority, home.request(code, csr), NOW)) is RefuseReason.DENIED


def test_a_name_that_another_key_asks_for_waits_too(home: JoinSite) -> None:
    code = home.invite(uses=2)
    csr = asked("/fleet/a")
    home.store.requests.add(check_request(csr, "home"), csr, "a file", NOW)
    assert home.join(code, "/fleet/a") == PERSON


def test_the_requests_that_wait_are_bounded(home: JoinSite) -> None:
    code, other = home.invite(uses=100), home.invite(uses=100)
    issued(home.join(code, "/fleet/a"))
    for _ in range(MAX_WAITING):
        assert home.join(code, "/fleet/a") == PERSON
    assert refusal(home.join(code, "/fleet/a")) is RefuseReason.BUSY
    assert home.join(other, "/fleet/a") == PERSON
    assert issued(home.join(code, "/fleet/b"))


def test_the_record_is_full_of_requests(home: JoinSite, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ca.store.identities.MAX_OPEN", 0)
    code = home.invite()
    assert refusal(home.join(code)) is RefuseReason.BUSY
    assert uses(home, code.id) == []


def test_a_revoked_key(home: JoinSite) -> None:
    key, code = new_signer(), home.invite(uses=2)
    issued(home.join(code, "/fleet/a", key))
    home.authority.revoke_identity("/fleet/a", "stolen", NOW)
    assert refusal(home.join(code, "/fleet/a", key)) is RefuseReason.DENIED
    assert uses(home, code.id) == ["/fleet/a"]


def test_a_record_that_cannot_be_used_is_no_refusal(home: JoinSite) -> None:
    request = home.request(home.invite(), asked("/fleet/a"))
    home.store.close()
    with pytest.raises(RecordUnusable):
        join(home.authority, request, NOW)


def test_while_the_authority_is_locked(home: JoinSite) -> None:
    code, csr = home.invite(), asked("/fleet/a")
    request = home.request(code, csr)
    assert join_locked(home.store, request, NOW) == LOCKED
    assert refusal(join_locked(home.store, request, NOW + HOUR + 1)) is RefuseReason.ENDED
    issued(join(home.authority, request, NOW))
    assert join_locked(home.store, request, NOW + HOUR + 1) == LOCKED


def test_metadata_are_looked_at_for_who_proves_an_invitation_that_is_open_or_was_used(home: JoinSite) -> None:
    code, store = home.invite(uses=2), home.store
    request = home.request(code, asked("/fleet/a"))
    assert allowed_pattern(store, request, NOW) == "/fleet/*"
    unproved = replace(request, metadata=b"<node/>")
    assert allowed_pattern(store, unproved, NOW) == RefusedMessage(RefuseReason.REFUSED)
    unknown = replace(request, invitation=bytes(32))
    assert allowed_pattern(store, unknown, NOW) == RefusedMessage(RefuseReason.REFUSED)
    late = NOW + 2 * HOUR
    assert allowed_pattern(store, request, late) == RefusedMessage(RefuseReason.ENDED)
    join(home.authority, request, NOW)
    assert allowed_pattern(store, request, late) == "/fleet/*"
