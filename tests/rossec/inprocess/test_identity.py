import inspect
import time
from pathlib import Path
from threading import Thread
from typing import Any
from unittest.mock import create_autospec

import pytest

from ca.certificates import Identity
from ca.errors import CAError, Revoked
from ca.revocation.lists import Timestamp, digest, open_list, sign_timestamp
from grants.errors import GrantMissing
from grants.model import Right
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.inprocess.identity import LocalIdentity, LockedAccess, now
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


def update_revocations(
    local_identity: LocalIdentity, data: bytes, timestamp: bytes, master: Identity
) -> None:
    save = local_identity.home.save_revocations
    local_identity.access.update_revocations(data, timestamp, master, now(), save)


def test_an_identity_is_loaded_from_its_directory(site: Site) -> None:
    local_identity = LocalIdentity(site.enroll("/robot"), "/robot")
    assert local_identity.identity.name == "/robot"
    with pytest.raises(ConfigurationError, match=r"has no ca\.pem"):
        LocalIdentity(NodeHome.of(site.root, "/other"), "/other")


def test_a_list_is_fresh_only_with_its_confirmation(site: Site) -> None:
    local_identity = LocalIdentity(site.enroll("/robot"), "/robot")
    master, peer = site.identity("/master"), site.identity("/viewer")
    data = site.revoke(bytes(32))
    with pytest.raises(CAError):
        local_identity.access.check_peer(peer, int(time.time()))
    with pytest.raises(CAError):
        update_revocations(local_identity, data, b"", master)
    update_revocations(local_identity, data, stamped(site, data), master)
    local_identity.access.check_peer(peer, int(time.time()))
    with pytest.raises(GrantMissing):
        local_identity.access.authorize(peer, None, Right.CALL, "/x", int(time.time()))
    again = LocalIdentity(site.enroll("/robot"), "/robot")
    assert again.revocations.data == data, "the newest list is on disk"
    revoked = site.revoke(peer.thumbprint)
    update_revocations(local_identity, revoked, stamped(site, revoked), master)
    with pytest.raises(Revoked):
        local_identity.access.check_peer(peer, int(time.time()))


def test_a_renewed_identity_is_used(site: Site) -> None:
    home = site.enroll("/robot")
    local_identity = LocalIdentity(home, "/robot")
    assert not local_identity.refresh_identity()
    site.renew("/robot", 3600)
    before, context = local_identity.credentials, local_identity.context
    assert local_identity.refresh_identity()
    assert local_identity.credentials.chain != before.chain
    assert local_identity.context.credentials is local_identity.credentials
    assert local_identity.context.half_open is context.half_open
    assert context.credentials is before, "a handshake under way has the credentials it began with"
    assert local_identity.identity.not_after <= site.now() + 3600


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
