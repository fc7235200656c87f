from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from ca.errors import NameCovered, StoreError
from ca.store import identities as request_record
from ca.store.record import Store
from ca.store.values import DAY, CertificateRow, RequestState
from ca.svid import IdentityRequest, build_request, check_request
from tests.support import refusal_texts
from tests.support.pki import NOW, new_signer


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(Store.create(tmp_path / "ca.db")) as store:
        yield store


def asked(name: str = "/a") -> tuple[IdentityRequest, bytes]:
    der = build_request(new_signer(), "home", name)
    return check_request(der, "home"), der


def pending(store: Store, name: str = "/a", now: int = NOW) -> IdentityRequest:
    request, der = asked(name)
    store.requests.add(request, der, "192.0.2.7", now)
    return request


def certificate(request: IdentityRequest, serial: int = 1) -> CertificateRow:
    return CertificateRow(serial, request.name, request.thumbprint, b"der", NOW, NOW + DAY)


def issue(store: Store, request: IdentityRequest, serial: int = 1) -> None:
    store.add_certificate(certificate(request, serial), NOW, request=request.digest)


def log_of(store: Store) -> list[tuple[str, str, str]]:
    return [entry[2:5] for entry in store.log.entries()]


def test_a_request_goes_from_pending_to_issued(store: Store) -> None:
    request = pending(store)
    (row,) = store.requests.all()
    assert (row.name, row.source, row.state) == ("/a", "192.0.2.7", RequestState.PENDING)
    assert store.requests.approve(request.digest, NOW + 1, "known").state is RequestState.APPROVED
    assert store.identities.issued_for(request.digest) is None
    issue(store, request)
    assert store.requests.get(request.digest).state is RequestState.ISSUED
    assert store.identities.issued_for(request.digest) == certificate(request)
    assert log_of(store) == [
        ("pending", "/a", "192.0.2.7"),
        ("approved", "/a", "known"),
        ("issued", "/a", ""),
        ("certificate", "/a", request.thumbprint.hex()),
    ]


def test_one_request_is_recorded_once(store: Store) -> None:
    request, der = asked()
    first = store.requests.add(request, der, "here", NOW)
    assert store.requests.add(request, der, "there", NOW + 1) == first
    assert len(store.requests.all()) == 1


def test_a_request_gets_one_certificate(store: Store) -> None:
    request = pending(store)
    store.requests.approve(request.digest, NOW)
    issue(store, request)
    with pytest.raises(StoreError, match="this request of /a has its certificate already"):
        issue(store, request, 2)
    store.requests.collect(NOW + 30 * DAY)
    with pytest.raises(StoreError, match="this request of /a has its certificate already"):
        issue(store, request, 2)
    _, der = asked()
    with pytest.raises(StoreError, match="has its certificate already") as caught:
        store.requests.add(request, der, "again", NOW + 30 * DAY)
    assert "rossec ca renew /a" in caught.value.hint
    assert len(store.identities.all()) == 1


def test_only_what_was_approved_is_issued(store: Store) -> None:
    request = pending(store)
    with pytest.raises(StoreError, match="is pending and cannot be issued"):
        issue(store, request)
    store.requests.deny(request.digest, NOW, "unknown")
    with pytest.raises(StoreError, match="is denied and cannot be issued"):
        issue(store, request)
    with pytest.raises(StoreError, match="the request is not recorded"):
        issue(store, asked()[0])
    assert store.identities.all() == []


def test_what_was_approved_can_still_be_denied(store: Store) -> None:
    request = pending(store)
    store.requests.approve(request.digest, NOW)
    store.requests.deny(request.digest, NOW, "a mistake")
    with pytest.raises(StoreError, match="is denied and cannot be denied"):
        store.requests.deny(request.digest, NOW)


@pytest.mark.attack("clock-ahead")
def test_a_clock_that_is_ahead_deletes_nothing(store: Store) -> None:
    waiting, denied = pending(store), pending(store, "/b")
    store.requests.deny(denied.digest, NOW)
    for later in (DAY + 1, 8 * DAY, 4000 * DAY):
        assert store.requests.collect(NOW + later) == []
        assert store.requests.open(NOW + later) == []
    assert store.requests.all(NOW + 2 * DAY) == [store.requests.get(denied.digest)]
    assert [row.digest for row in store.requests.open(NOW)] == [waiting.digest]
    assert store.requests.approve(waiting.digest, NOW)


def test_of_what_expired_long_ago_the_newest_stay(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(request_record, "KEPT_EXPIRED", 2)
    made = [pending(store, f"/{letter}", NOW + at) for at, letter in enumerate("abc")]
    assert store.requests.collect(NOW + 20 * DAY) == []
    late = NOW + 32 * DAY
    assert [row.digest for row in store.requests.collect(late)] == [made[0].digest]
    assert log_of(store)[-1:] == [("collected", "/a", "pending")]
    assert store.requests.collect(late) == []


def test_what_expired_can_be_asked_anew(store: Store) -> None:
    request, der = asked()
    store.requests.add(request, der, "", NOW)
    again = store.requests.add(request, der, "screen", NOW + 2 * DAY)
    assert (again.arrived, again.source) == (NOW + 2 * DAY, "screen")
    assert len(store.requests.all()) == 1


def test_a_void_request_is_not_approved(store: Store) -> None:
    request = pending(store)
    with pytest.raises(StoreError, match="was pending for too long and has expired"):
        store.requests.approve(request.digest, NOW + DAY + 1)


@pytest.mark.attack("looker-floods")
def test_those_who_join_leave_room_for_who_enrolls_by_hand(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(request_record, "MAX_JOINING", 2)
    for _ in range(2):
        request, der = asked()
        store.requests.add(request, der, "invitation 12345678", NOW)
    request, der = asked()
    with pytest.raises(StoreError, match="requests are pending"):
        store.requests.add(request, der, "invitation 87654321", NOW)
    assert store.requests.add(request, der, "file", NOW)


def test_the_number_of_open_requests_is_limited(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(request_record, "MAX_OPEN", 2)
    first = pending(store)
    pending(store, "/b")
    with pytest.raises(StoreError, match="2 requests are pending"):
        pending(store, "/c")
    store.requests.deny(first.digest, NOW)
    pending(store, "/c")


def test_found_by_the_beginning_of_its_digest(store: Store) -> None:
    request = pending(store)
    pending(store, "/b")
    assert store.requests.get(request.digest[:4]).digest == request.digest
    for missing in (b"", b"x" * 32):
        with pytest.raises(StoreError, match="requests begin with"):
            store.requests.get(missing)


def test_two_keys_that_request_one_name(store: Store) -> None:
    first, second = pending(store), pending(store)
    with pytest.raises(StoreError, match="two different keys request the name /a") as caught:
        store.requests.approve(first.digest, NOW)
    assert f"rossec ca deny {second.digest.hex()[:8]}" in caught.value.hint
    store.requests.deny(second.digest, NOW)
    store.requests.approve(first.digest, NOW)


def test_the_same_key_may_ask_twice(store: Store) -> None:
    signer = new_signer()
    ders = [build_request(signer, "home", "/a") for _ in "ab"]
    requests = [check_request(der, "home") for der in ders]
    for request, der in zip(requests, ders, strict=True):
        store.requests.add(request, der, "", NOW)
    store.requests.approve(requests[0].digest, NOW)


def test_a_known_name_keeps_its_key_unless_it_is_said(store: Store) -> None:
    first = pending(store)
    store.requests.approve(first.digest, NOW)
    issue(store, first)
    second = pending(store)
    with pytest.raises(StoreError, match=refusal_texts.KEY_CHANGED) as caught:
        store.requests.approve(second.digest, NOW)
    assert "--replace-key /a" in caught.value.hint
    with pytest.raises(StoreError, match="the key of /b was to be replaced, but the request is of /a"):
        store.requests.approve(second.digest, NOW, replace_key="/b")
    row = store.requests.approve(second.digest, NOW, "new disk", replace_key="/a")
    assert row.replaces
    assert store.requests.get(second.digest).replaces
    assert log_of(store)[-1] == ("approved", "/a", "new disk; replaces the key")


def test_anonymous_names_are_the_approvers_word(store: Store) -> None:
    request = pending(store, "/rviz")
    assert store.requests.approve(request.digest, NOW, wildcard=True).wildcard
    assert store.requests.get(request.digest).wildcard
    assert log_of(store)[-1] == ("approved", "/rviz", "anonymous nodes")
    other = pending(store, "/tool_1")
    store.requests.approve(other.digest, NOW)
    issue(store, other)
    wide = pending(store, "/tool")
    with pytest.raises(NameCovered, match="/tool and /tool_1"):
        store.requests.approve(wide.digest, NOW, wildcard=True)
    store.requests.approve(wide.digest, NOW)


def test_a_faster_command_wins(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was read before the transaction is not what the transaction finds."""
    request = pending(store)
    stale = store.requests.get(request.digest)
    store.requests.deny(request.digest, NOW)
    monkeypatch.setattr(store.requests, "get", lambda _: stale)
    with pytest.raises(StoreError, match="a request does not go this way"):
        store.requests.approve(request.digest, NOW)
    assert [entry.what for entry in store.log.entries()] == ["pending", "denied"]


def test_open_requests_and_one_by_its_digest(store: Store) -> None:
    waits, denied = pending(store), pending(store, "/b")
    store.requests.deny(denied.digest, NOW)
    assert [row.digest for row in store.requests.open()] == [waits.digest]
    found = store.requests.find(denied.digest)
    assert found is not None
    assert found.state is RequestState.DENIED
    assert store.requests.find(denied.digest[:8]) is None
