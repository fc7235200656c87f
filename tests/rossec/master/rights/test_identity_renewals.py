"""Requests for renewals at the master, with an authority beside it that answers, or does not."""

import hashlib
from pathlib import Path
from typing import Any

import pytest

from ca.certificates import MAX_AGE, MAX_RENEWAL, Renewal, open_renewal, sign_renewal
from ca.errors import CAError, Revoked
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.svid import build_request
from rossec.authority.renewals import renew
from rossec.master.rights import renewals as module
from rossec.master.rights.renewals import (
    ANSWER_KEPT,
    OFFER_LIMIT,
    OFFERED_AGAIN,
    SPACING,
    VERIFY_SPACING,
    IdentityRenewals,
    RenewalAnswer,
    Settlement,
)
from tests.support.site import DAY, Site

BEGAN = 1_800_000_000
LIFE = 30 * DAY
NOW = BEGAN + 25 * DAY


class Office:
    """A master's table, nodes that ask, and an authority that answers what it is offered."""

    def __init__(self, root: Path) -> None:
        self.now = BEGAN
        self.site = Site(root / "site", clock=lambda: self.now)
        self.asked = list[int]()
        self.answered = list[bytes]()
        self.revoked = set[bytes]()
        self.table = IdentityRenewals(self.site.anchor)
        self.table.on_asked = lambda: self.asked.append(self.now)
        self.table.on_answered = self.answered.append
        for name in ("/robot", "/eve"):
            self.site.enroll(name, LIFE)
        self.now = NOW

    def key(self, name: str) -> bytes:
        return self.site.identity(name).thumbprint

    def request(self, name: str, key: KeySigner | None = None) -> bytes:
        own = self.site.enroll(name).credentials()
        csr = build_request(own.signer if key is None else key, "home", name)
        return sign_renewal(own.signer, own.chain, csr, self.now)

    def check(self, entry: bytes, now: int) -> None:
        if entry in self.revoked:
            raise Revoked("it is revoked")

    def ask(self, name: str, request: bytes = b"", holder: bytes = b"") -> RenewalAnswer:
        request = request or self.request(name)
        return self.table.ask(holder or self.key(name), request, self.now, self.check)

    def serve(self) -> int:
        """The authority's service answers what there is; returns how much."""
        found = self.table.offer(self.now, locked=False).requests
        answers = [
            Settlement(hashlib.sha256(data).digest(), renew(self.site.authority, data, self.now), "")
            for data in found
        ]
        return self.table.settle(answers, self.now, self.check)


@pytest.fixture
def office(tmp_path: Path) -> Office:
    return Office(tmp_path)


def test_a_node_asks_and_finds_its_new_identity(office: Office) -> None:
    office.table.offer(office.now, locked=False)
    bundle, status = office.ask("/robot")
    assert (bundle, office.asked) == (b"", [NOW])
    assert status == "the authority's service has been asked; the answer is here in a moment"
    assert office.table.waiting(office.now) == 1
    assert office.serve() == 1
    assert office.answered == [office.key("/robot")]
    office.now += 5
    found = office.ask("/robot")
    assert found.status == "identity renewed"
    assert office.ask("/robot") == found, "an answer may be lost"
    home = office.site.enroll("/robot")
    assert home.install(found.bundle, office.now).not_after == NOW + LIFE
    assert office.table.waiting(office.now) == 0


def test_the_next_renewal_is_not_answered_with_the_last(office: Office) -> None:
    office.ask("/robot")
    office.serve()
    home = office.site.enroll("/robot")
    home.install(office.ask("/robot").bundle, office.now)
    with pytest.raises(CAError, match="is not due for renewal"):
        office.ask("/robot")
    office.now += 25 * DAY
    assert office.ask("/robot").bundle == b""


@pytest.mark.parametrize(
    ("seen", "locked", "says"),
    [
        (None, False, "service does not run"),
        (module.AUTHORITY_SEEN, False, "service does not run"),
        (5, True, "the authority's key is locked (where the authority is: rossec ca unlock"),
        (5, False, "has been asked"),
    ],
)
def test_a_node_is_told_who_must_do_what(office: Office, seen: int | None, locked: bool, says: str) -> None:
    if seen is not None:
        office.table.offer(office.now - seen, locked=locked)
    assert says in office.ask("/robot").status


def test_a_locked_service_is_told_how_many_wait(office: Office) -> None:
    office.ask("/robot")
    office.ask("/eve")
    assert office.table.offer(office.now, locked=True) == ([], 2)
    assert len(office.table.offer(office.now, locked=False).requests) == 2


def test_a_request_is_offered_once_until_it_should_have_been_answered(office: Office) -> None:
    office.ask("/robot")
    assert len(office.table.offer(office.now, locked=False).requests) == 1
    assert office.table.offer(office.now + 1, locked=False) == ([], 1)
    office.now += OFFERED_AGAIN
    fresh = office.request("/robot")
    office.ask("/robot", fresh)
    assert office.asked == [NOW, office.now]
    assert office.table.offer(office.now, locked=False).requests == [fresh]


def test_a_request_does_not_outlive_its_signature(office: Office) -> None:
    office.ask("/robot")
    office.now += MAX_AGE
    assert office.table.waiting(office.now) == 0
    assert office.table.offer(office.now, locked=False) == ([], 0)


def test_a_refusal_reaches_the_node_and_it_may_ask_again(office: Office) -> None:
    request = office.request("/robot")
    office.ask("/robot", request)
    office.table.offer(office.now, locked=False)
    refusal = Settlement(hashlib.sha256(request).digest(), b"", "not in the record")
    assert office.table.settle([refusal], office.now, office.check) == 1
    for _ in range(2):
        with pytest.raises(CAError, match="not in the record"):
            office.ask("/robot")
    office.now += SPACING
    assert office.ask("/robot").bundle == b""
    assert office.serve() == 1


def test_only_the_holder_of_the_key_asks_and_for_its_own_name(office: Office) -> None:
    with pytest.raises(CAError, match="this connection is not of /robot"):
        office.ask("/robot", holder=office.key("/eve"))
    own = office.site.enroll("/eve").credentials()
    foreign = sign_renewal(own.signer, own.chain, build_request(own.signer, "home", "/robot"), NOW)
    with pytest.raises(CAError, match="/eve requests the identity of /robot"):
        office.ask("/eve", foreign)
    office.revoked.add(office.key("/eve"))
    with pytest.raises(Revoked):
        office.ask("/eve")
    with pytest.raises(CAError, match="too long"):
        office.ask("/robot", b"x" * (MAX_RENEWAL + 1))
    assert office.table.waiting(office.now) == 0


def test_an_answer_is_only_what_was_asked_for(office: Office) -> None:
    office.ask("/robot")
    office.ask("/eve")
    found = office.table.offer(office.now, locked=False).requests
    digests = [hashlib.sha256(data).digest() for data in found]
    bundles = [renew(office.site.authority, data, office.now) for data in found]
    wrong = [
        Settlement(bytes(32), bundles[0], ""),
        Settlement(digests[0], bundles[1], ""),
        Settlement(digests[0], b"noise", ""),
        Settlement(digests[0], Site(office.site.root / "other").anchor.certificate, ""),
    ]
    assert office.table.settle(wrong, office.now, office.check) == 0
    office.revoked.add(office.key("/eve"))
    right = [Settlement(*each, "") for each in zip(digests, bundles, strict=True)]
    assert office.table.settle(right, office.now, office.check) == 1, "one is revoked meanwhile"
    assert office.table.settle(right, office.now, office.check) == 0, "it is answered"


def test_one_key_has_one_place_and_its_requests_are_verified_now_and_then(
    office: Office, monkeypatch: pytest.MonkeyPatch
) -> None:
    verified = list[bytes]()

    def counts(data: bytes, *rest: Any) -> Renewal:
        verified.append(data)
        return open_renewal(data, *rest)

    monkeypatch.setattr(module, "open_renewal", counts)
    for _ in range(100):
        office.ask("/robot")
    assert (len(verified), len(office.asked)) == (1, 1)
    assert office.table.waiting(office.now) == 1
    office.now += VERIFY_SPACING
    office.ask("/robot")
    assert len(verified) == 2
    assert office.serve() == 1
    other = office.request("/robot", KeySigner(generate()))
    assert "ask again later" in office.ask("/robot", other).status
    office.now += ANSWER_KEPT
    assert office.ask("/robot", office.request("/robot", KeySigner(generate()))).bundle == b""
    assert office.asked == [NOW, NOW + VERIFY_SPACING, office.now]


def test_a_request_for_another_key_waits_for_its_turn(office: Office) -> None:
    office.ask("/robot")
    office.now += VERIFY_SPACING
    other = office.request("/robot", KeySigner(generate()))
    assert "ask again later" in office.ask("/robot", other).status
    office.now += SPACING
    office.ask("/robot", office.request("/robot", KeySigner(generate())))
    assert office.table.waiting(office.now) == 1


def test_the_table_is_bounded(office: Office, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_KEPT", 1)
    office.ask("/robot")
    with pytest.raises(CAError, match="takes no more"):
        office.ask("/eve")
    office.now += MAX_AGE
    assert office.ask("/eve").bundle == b""


def test_the_service_is_offered_some_at_a_time(office: Office, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "OFFER_LIMIT", 1)
    assert OFFER_LIMIT > 1
    office.ask("/robot")
    office.ask("/eve")
    assert [len(office.table.offer(NOW, locked=False).requests) for _ in range(3)] == [1, 1, 0]


def test_an_intermediate_of_this_host_answers_at_once(office: Office) -> None:
    table = IdentityRenewals(office.site.anchor, lambda *_: b"bundle")
    answer = table.ask(office.key("/robot"), b"x", office.now, office.check)
    assert answer == (b"bundle", "identity renewed")
