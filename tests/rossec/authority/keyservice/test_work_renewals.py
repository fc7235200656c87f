"""What the service does with the requests of nodes whose identity is due."""

from contextlib import closing
from hashlib import sha256
from pathlib import Path

import pytest

from ca.certificates import sign_renewal
from ca.svid import build_request
from rossec.home import NodeHome
from tests.rossec.authority.keyservice.test_work import DAY, NOW, SECRET, Working


@pytest.fixture
def working(tmp_path: Path) -> Working:
    return Working(tmp_path)


def test_identities_are_renewed_and_the_reason_is_said(working: Working) -> None:
    home = NodeHome.of(working.root, "/robot")
    home.create_request("home")
    authority = working.home.unlock(SECRET)
    with closing(authority.store):
        home.install(authority.issue(home.request(), NOW, 30 * DAY), NOW)
    working.now = NOW + 25 * DAY
    own = home.credentials()
    csr = build_request(own.signer, "home", "/robot")
    asked = sign_renewal(own.signer, own.chain, csr, working.now)
    one, two = working.work.renew_identities([asked, b"noise"])
    assert one[0] == sha256(asked).digest()
    assert home.install(one[1], working.now).not_after == working.now + 30 * DAY
    assert (two[1], "this is not a renewal" in two[2]) == (b"", True)
    assert working.audit[-1].endswith(", for a node that renews its identity")
    working.operations.held.lock()
    assert working.work.renew_identities([asked]) == [], "they are asked for again"


def test_a_request_that_crashes_holds_no_other_back(
    working: Working, monkeypatch: pytest.MonkeyPatch
) -> None:
    def renew(_authority: object, request: bytes, _now: int) -> bytes:
        if request == b"poison":
            raise ZeroDivisionError
        if request == b"full":
            raise OSError(28, "No space left on device")
        return b"bundle"

    monkeypatch.setattr("rossec.authority.renewals.renew_recorded", renew)
    given = working.work.renew_identities([b"poison", b"good", b"full", b"later"])
    assert [(bundle, bool(reason)) for _, bundle, reason in given] == [(b"", True), (b"bundle", False)]
