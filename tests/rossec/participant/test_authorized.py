"""One authorized connection: when it ends, and what takes the place of its decision."""

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ca.revocation.lists import Timestamp, digest
from ca.revocation.trust_status import Revocations, TrustStatus
from rossec.clock import Clock
from rossec.participant.authorized import STALE_GRACE, AuthorizedConnection
from tests.support.domains import alone
from tests.support.site import Site

NOW = int(time.time())
GRANT, LATER, KEY = b"g" * 16, b"l" * 16, b"k" * 32


@pytest.fixture(autouse=True)
def _clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: NOW))


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site", clock=lambda: NOW)


def trust_status(site: Site) -> TrustStatus:
    held = Revocations(site.anchor.public_key)
    data = site.authority.store.newest_list()
    assert data is not None
    held.update(data, NOW)
    assert held.current is not None
    held.confirm(Timestamp(held.current.seq, digest(data), NOW, 30), NOW)
    return alone(site.anchor, held)


def decision(
    *ids: bytes, expires: int = NOW + 100, name: str = "/word", keep: bool = False, pad: int = 0
) -> Any:
    return SimpleNamespace(
        grant_ids=ids, grants=(), keep_when_stale=keep, expires=expires, name=name, pad=pad
    )


def connection(made: Any, **options: Any) -> AuthorizedConnection[Any, str]:
    peer = SimpleNamespace(name="/viewer", keys=(KEY,), not_after=NOW + 50, domain="home", is_foreign=False)
    padded: list[int] = []
    stream = SimpleNamespace(peer=peer, padded=padded, pad_units=padded.append)
    return AuthorizedConnection(stream, made, "first", **options)


def test_it_ends_with_the_grant_or_the_certificate() -> None:
    assert connection(decision(GRANT, expires=NOW + 10)).ends == NOW + 10
    assert connection(decision(GRANT)).ends == NOW + 50


def test_what_is_sent_is_padded_as_the_decision_in_force_says() -> None:
    made = connection(decision(GRANT, pad=256))
    assert made.stream.padded == [256]
    made.replace(decision(LATER, pad=256), "second")
    made.replace(decision(GRANT), "third")
    made.replace(decision(LATER, pad=64), "fourth")
    assert made.stream.padded == [256, 0, 64]


def test_while_a_guard_is_replaced_the_longer_padding_is_in_force() -> None:
    """A thread that sends meanwhile sends nothing unpadded that either decision pads."""
    at_swap: list[list[int]] = []
    made = connection(decision(GRANT))
    made.swap = lambda _: at_swap.append([*made.stream.padded])
    made.replace(decision(LATER, pad=64), "filtered")
    made.replace(decision(GRANT), "open again")
    assert at_swap == [[64], [64]]
    assert made.stream.padded == [64, 0]


def test_another_decision_takes_its_place(site: Site) -> None:
    made = connection(decision(GRANT, expires=NOW + 10))
    made.replace(decision(LATER, expires=NOW + 40), "second")
    assert (made.guard, made.ends) == ("second", NOW + 40)
    assert made.termination_reason(trust_status(site), NOW + 10) is None
    site.revoke(GRANT.ljust(32))
    assert made.termination_reason(trust_status(site), NOW) is None
    site.authority.revoke(LATER, "", NOW)
    assert made.termination_reason(trust_status(site), NOW) == f"{LATER.hex()} is revoked"


def test_another_certificate_moves_its_end() -> None:
    made = connection(decision(GRANT))
    made.stream.peer.not_after = NOW + 70
    made.update_end()
    assert made.ends == NOW + 70


def test_a_guard_that_is_in_force_elsewhere_is_swapped_there() -> None:
    swapped: list[str] = []
    made = connection(decision(GRANT), swap=swapped.append)
    made.replace(decision(GRANT), "second")
    assert swapped == ["second"]


def test_stale_lists_end_it_after_a_while_unless_the_grant_says_keep(site: Site) -> None:
    held = trust_status(site)
    late = held.own.fresh_until + STALE_GRACE
    for keep, ends in ((False, True), (True, False)):
        made = connection(decision(GRANT, keep=keep, expires=late + 10))
        made.stream.peer.not_after = late + 10
        made.update_end()
        assert (made.termination_reason(held, late) is not None) is ends
        assert made.termination_reason(held, late - 1) is None


def test_a_name_of_a_domain_that_is_listed_no_longer_ends_it(site: Site) -> None:
    for name in ("/remote/hospital/pose", "/gateway/hospital/pose"):
        made = decision(GRANT, name=name)
        made.grants = (SimpleNamespace(domain="hospital"),)
        reason = connection(made).termination_reason(trust_status(site), NOW)
        assert reason is not None
    assert connection(decision(GRANT)).termination_reason(trust_status(site), NOW) is None
