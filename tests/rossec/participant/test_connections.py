import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ca.revocation.state import Revocations, Timestamp, digest
from rossec.participant.connections import STALE_GRACE, termination_reason
from tests.support.site import Site

NOW = int(time.time())
GRANT = b"g" * 16
KEY, ABOVE = b"k" * 32, b"i" * 32


class Linked:
    def __init__(self, ends: int = NOW + 1000, keep: bool = False) -> None:
        self.stream: Any = SimpleNamespace(peer=SimpleNamespace(keys=(KEY, ABOVE)))
        self.decision: Any = SimpleNamespace(grant_ids=(GRANT,), keep_when_stale=keep)
        self.ends = ends


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site", clock=lambda: NOW)


def revocations(site: Site) -> Revocations:
    held = Revocations(site.anchor.public_key)
    data = site.authority.store.newest_list()
    assert data is not None
    held.update(data, NOW)
    assert held.current is not None
    held.confirm(Timestamp(held.current.seq, digest(data), NOW, 30), NOW)
    return held


def test_a_link_in_order_lives(site: Site) -> None:
    assert termination_reason(Linked(), revocations(site), NOW) is None


@pytest.mark.parametrize("late", [0, 1])
def test_an_expired_one_is_cut_to_the_second(site: Site, late: int) -> None:
    assert termination_reason(Linked(ends=NOW), revocations(site), NOW - 1) is None
    reason = termination_reason(Linked(ends=NOW), revocations(site), NOW + late)
    assert reason == "its grant or its certificate has expired"


@pytest.mark.parametrize("entry", [GRANT, KEY, ABOVE])
def test_a_revoked_grant_or_key_cuts(site: Site, entry: bytes) -> None:
    site.authority.revoke(entry, "", NOW)
    assert termination_reason(Linked(), revocations(site), NOW) == f"{entry.hex()} is revoked"


def test_silence_is_borne_for_a_while(site: Site) -> None:
    held = revocations(site)
    last = held.fresh_until + STALE_GRACE
    assert termination_reason(Linked(), held, last - 1) is None
    assert "confirmation expired" in (termination_reason(Linked(), held, last) or "")


def test_without_any_list_nothing_lives(site: Site) -> None:
    never = Revocations(site.anchor.public_key)
    assert termination_reason(Linked(), never, NOW) is not None


def test_what_must_not_stop_outlives_silence_but_neither_revocation_nor_expiry(site: Site) -> None:
    never = Revocations(site.anchor.public_key)
    held = revocations(site)
    long_after = held.fresh_until + 10 * STALE_GRACE
    assert termination_reason(Linked(keep=True), never, NOW) is None
    assert termination_reason(Linked(ends=long_after + 1, keep=True), held, long_after) is None
    assert termination_reason(Linked(keep=True), held, NOW + 1000) is not None
    site.authority.revoke(GRANT, "", NOW)
    assert termination_reason(
        Linked(ends=long_after + 1, keep=True), revocations(site), long_after
    ) == (f"{GRANT.hex()} is revoked")


def test_a_revoked_grant_cuts_while_silence_is_still_borne(site: Site) -> None:
    site.authority.revoke(GRANT, "", NOW)
    held = revocations(site)
    assert termination_reason(Linked(), held, held.fresh_until + 1) == f"{GRANT.hex()} is revoked"
