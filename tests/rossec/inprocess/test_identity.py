import dataclasses
import inspect
import time
from pathlib import Path
from threading import Thread
from typing import Any
from unittest.mock import create_autospec

import pytest

from ca.errors import CAError, RevocationsStale
from ca.revocation.state import Timestamp, digest, open_list, sign_timestamp
from grants.errors import GrantMissing
from grants.model import Right
from rossec.clock import Clock
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.inprocess.identity import LocalIdentity, LockedAccess, now
from rossec.inprocess.process import SecuredProcess
from rossec.inprocess.reporting import Reporter
from rossec.participant.access import Access
from tests.support.site import Site


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


def stamped(site: Site, data: bytes) -> bytes:
    signer = site.enroll("/master").credentials().signer
    return sign_timestamp(signer, Timestamp(_seq(site, data), digest(data), site.now(), 30))


def _seq(site: Site, data: bytes) -> int:
    return open_list(data, site.anchor.public_key).seq


def test_a_member_is_what_its_directory_says(site: Site) -> None:
    member = LocalIdentity(site.enroll("/robot"), "/robot")
    assert member.identity.name == "/robot"
    with pytest.raises(ConfigurationError, match=r"has no ca\.pem"):
        LocalIdentity(NodeHome.of(site.root, "/other"), "/other")


def test_a_list_counts_only_with_its_confirmation(site: Site) -> None:
    member = LocalIdentity(site.enroll("/robot"), "/robot")
    master, peer = site.identity("/master"), site.identity("/viewer")
    data = site.revoke(bytes(32))
    with pytest.raises(CAError):
        member.access.check_peer(peer, int(time.time()))
    with pytest.raises(CAError):
        member.take_revocations(data, b"", master)
    member.take_revocations(data, stamped(site, data), master)
    member.access.check_peer(peer, int(time.time()))
    with pytest.raises(GrantMissing):
        member.access.authorize(peer, None, Right.CALL, "/x", int(time.time()))
    assert not member.is_revoked(peer)
    again = LocalIdentity(site.enroll("/robot"), "/robot")
    assert again.revocations.data == data, "the newest list outlives the process"
    revoked = site.revoke(peer.thumbprint)
    member.take_revocations(revoked, stamped(site, revoked), master)
    assert member.is_revoked(peer)


def test_a_renewed_identity_is_taken_over(site: Site) -> None:
    home = site.enroll("/robot")
    member = LocalIdentity(home, "/robot")
    assert not member.refresh_identity()
    site.renew("/robot", 3600)
    before = member.credentials
    assert member.refresh_identity()
    assert member.credentials.chain != before.chain
    assert member.identity.not_after <= site.now() + 3600


def test_a_key_that_vouches_for_a_peer_ends_it_too(site: Site) -> None:
    member = LocalIdentity(site.enroll("/robot"), "/robot")
    peer = dataclasses.replace(site.identity("/viewer"), issuers=(b"i" * 32,))
    assert not member.is_revoked(peer)
    member.revocations.update(site.revoke(b"i" * 32), site.now())
    assert member.is_revoked(peer)
    assert not member.is_revoked(site.identity("/viewer"))


def test_after_a_clock_that_went_back_it_waits_for_news(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    shows = time.time()
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: shows, lambda: 0.0))
    said: list[str] = []
    process = SecuredProcess(Reporter(print))
    monkeypatch.setattr(process.reporter, "warn", said.append)
    member = LocalIdentity(site.enroll("/robot"), "/robot")
    monkeypatch.setattr(SecuredProcess, "member", member)
    data = site.authority.store.newest_list()
    assert data is not None
    member.take_revocations(data, stamped(site, data), site.identity("/master"))
    process.cut()
    member.revocations.check_fresh(now())
    shows -= 3600
    process.cut()
    with pytest.raises(RevocationsStale, match="not confirmed"):
        member.revocations.check_fresh(now())
    assert "the host's clock went back" in "".join(said)


def public_names(kind: type) -> set[str]:
    return {name for name in vars(kind) if not name.startswith("_")}


def arguments_of(method: Any) -> list[None]:
    return [None] * (len(inspect.signature(method).parameters) - 1)


@pytest.mark.parametrize("name", sorted(public_names(LockedAccess)))
def test_each_method_of_the_access_holds_the_lock(name: str) -> None:
    access = create_autospec(Access, instance=True)
    locked = LockedAccess(access)
    free: list[bool] = []

    def another_thread() -> None:
        free.append(locked.lock.acquire(blocking=False))

    def check_lock(*_: object) -> int:
        thread = Thread(target=another_thread)
        thread.start()
        thread.join()
        return 7

    method = getattr(LockedAccess, name)
    if isinstance(method, property):
        setattr(type(access), name, property(check_lock))
        assert getattr(locked, name) == 7
    else:
        getattr(access, name).side_effect = check_lock
        getattr(locked, name)(*arguments_of(method))
    assert free == [False]


def test_a_method_of_the_access_that_is_not_locked_is_unknown(
    monkeypatch: pytest.MonkeyPatch, site: Site
) -> None:
    monkeypatch.setattr(Access, "added", lambda _: None, raising=False)
    access = LocalIdentity(site.enroll("/robot"), "/robot").access
    assert public_names(LockedAccess) <= public_names(Access)
    with pytest.raises(AttributeError, match="added"):
        access.added()  # type: ignore[attr-defined]  # which is the point
