"""Grants that are renewed on open connections: judged as at first, within bounds, and presented."""

import logging
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from ca.encoding import encode
from grants.errors import GrantMissing
from grants.model import Right
from rossec import clock
from rossec.channel.negotiation import GrantsPresented, IdentityRenewed, PresentedRenewalRefused
from rossec.clock import Clock
from rossec.errors import ConnectionHeaderRefused, IdentityRefused
from rossec.participant import authorized
from rossec.participant.authorized import PACE, AuthorizedConnection, RenewedGrants

NOW = 1_800_000_000


class Stream:
    def __init__(self, key: bytes = b"k" * 32) -> None:
        self.peer: Any = SimpleNamespace(
            name="/viewer", thumbprint=key, keys=(key,), domain="home", is_foreign=False, not_after=NOW + 1000
        )
        self.reasons: list[str] = []
        self.presented: list[bytes] = []
        self.takes = True
        self.tell: Callable[[Any], None] = lambda _: None

    def abort(self, reason: str) -> None:
        self.reasons.append(reason)

    def on_renewal(self, callback: Callable[[Any], None]) -> None:
        self.tell = callback

    def present_grants(self, data: bytes) -> bool:
        if self.takes:
            self.presented.append(data)
        return self.takes


class Access:
    """Authorizes `b"good"` for 100 seconds from now on."""

    def __init__(self) -> None:
        self.good = {b"good"}
        self.judged = 0
        self.own = encode([b"mine"])

    def authorize(self, peer: Any, data: bytes, right: Right, name: str, now: int) -> Any:
        self.judged += 1
        assert (right, name) == (Right.SUBSCRIBE, "/word")
        if data == b"crash":
            raise ZeroDivisionError
        if data not in self.good:
            raise GrantMissing("no grant")
        return decision(now + 100, "new")

    def present(self, right: Right, name: str, now: int) -> bytes:
        assert (right, name) == (Right.PUBLISH, "/word")
        if not self.own:
            raise GrantMissing("no grant")
        return self.own


def decision(expires: int = NOW + 10, restrictions: str = "old") -> Any:
    return SimpleNamespace(
        right=Right.SUBSCRIBE, name="/word", expires=expires, restrictions=restrictions, pad=0, grant_ids=()
    )


def rebuild(made: Any) -> str:
    if made.restrictions == "unfit":
        raise ConnectionHeaderRefused("it does not fit")
    return f"guard of {made.restrictions}"


Connection = AuthorizedConnection[Any, str]


@pytest.fixture
def access() -> Access:
    return Access()


@pytest.fixture
def grants(access: Any, monkeypatch: pytest.MonkeyPatch) -> RenewedGrants:
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: NOW))
    return RenewedGrants(access)


def opened(grants: RenewedGrants, **options: Any) -> Connection:
    given = {"rebuild": rebuild, **options}
    made: Connection = AuthorizedConnection(Stream(), decision(), "old guard", **given)
    grants.opened(made, lambda connection: connection.stream.reasons.append("identity"))
    return made


def test_what_authorizes_the_peer_takes_the_place(grants: RenewedGrants) -> None:
    made = opened(grants)
    made.stream.tell(GrantsPresented(b"good"))
    assert (made.guard, made.ends) == ("guard of new", NOW + 100)
    assert made.presented.retry_at is None


def test_what_is_refused_leaves_the_decision_and_is_judged_again(
    grants: RenewedGrants, access: Access
) -> None:
    """A list or a clock may be behind: later, and in longer and longer intervals."""
    made = opened(grants)
    made.stream.tell(GrantsPresented(b"later"))
    assert (made.guard, made.ends) == ("old guard", NOW + 10)
    times = []
    for now in range(NOW, NOW + 40):
        before = access.judged
        grants.retry([made], now)
        times += [now - NOW] if access.judged > before else []
    assert times == [2, 6, 14, 30]
    access.good.add(b"later")
    grants.retry([made], NOW + 100)
    assert made.guard == "guard of new"


def test_it_is_judged_once_more_when_the_connection_would_end(grants: RenewedGrants, access: Access) -> None:
    made, never = opened(grants), opened(grants)
    made.stream.tell(GrantsPresented(b"later"))
    assert not grants.continues(made, NOW + 10)
    access.good.add(b"later")
    assert grants.continues(made, NOW + 10)
    assert not grants.continues(never, NOW + 10), "it has presented nothing"


def test_what_cannot_be_applied_to_the_connection_ends_it(
    grants: RenewedGrants, access: Access, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = opened(grants)
    monkeypatch.setattr(access, "authorize", lambda *_: decision(NOW + 100, "unfit"))
    made.stream.tell(GrantsPresented(b"good"))
    assert "needs a new connection" in made.stream.reasons[0]
    assert made.guard == "old guard"


def test_a_check_that_crashes_ends_the_connection(
    grants: RenewedGrants, caplog: pytest.LogCaptureFixture
) -> None:
    made = opened(grants)
    made.stream.tell(GrantsPresented(b"crash"))
    assert made.stream.reasons == ["what the peer presents cannot be judged"]
    assert "ZeroDivisionError" in caplog.text


def test_another_decision_is_checked_once_more(grants: RenewedGrants) -> None:
    """A revocation that arrived while it was judged has found the one before."""
    made = opened(grants)
    made.stream.tell(GrantsPresented(b"bad"))
    assert made.stream.reasons == []
    made.stream.tell(GrantsPresented(b"good"))
    assert made.stream.reasons == ["identity"]


def test_of_two_threads_that_judge_the_newest_presentation_wins(
    grants: RenewedGrants, access: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither the older one, nor the guard of one with the decision of the other."""
    made = opened(grants)
    access.good.add(b"older")
    judge = access.authorize

    def slowly(peer: Any, data: bytes, right: Right, name: str, now: int) -> Any:
        if data == b"older":
            monkeypatch.setattr(access, "authorize", judge)
            made.stream.tell(GrantsPresented(b"good"))
            return decision(NOW + 900, "older")
        return judge(peer, data, right, name, now)

    monkeypatch.setattr(access, "authorize", slowly)
    made.stream.tell(GrantsPresented(b"older"))
    assert (made.guard, str(made.decision.restrictions)) == ("guard of new", "new")
    assert made.ends == NOW + 100


def test_a_connection_that_takes_none_is_left_alone(grants: RenewedGrants, access: Access) -> None:
    made = opened(grants, rebuild=None)
    made.stream.tell(GrantsPresented(b"good"))
    grants.present([made], 1, NOW)
    assert (made.guard, access.judged, made.stream.presented) == ("old guard", 0, [])


def test_one_key_is_not_judged_for_ever(grants: RenewedGrants, access: Access) -> None:
    connections = [opened(grants) for _ in range(400)]
    for made in connections:
        made.stream.tell(GrantsPresented(b"bad"))
    assert access.judged == 256
    other = opened(grants)
    other.stream.peer.thumbprint = b"o" * 32
    other.stream.tell(GrantsPresented(b"good"))
    assert other.guard == "guard of new", "the budget of one is not that of another"
    before = access.judged
    grants.retry(connections, NOW + 2)
    assert access.judged == before + 16


def test_budgets_that_are_full_again_are_forgotten(
    grants: RenewedGrants, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(authorized, "_PEERS", 4)
    now = [NOW]
    monkeypatch.setattr(clock, "now", lambda: now[0])
    for number in range(20):
        now[0] += 10
        made = opened(grants)
        made.stream.peer.thumbprint = bytes([number]) * 32
        made.stream.tell(GrantsPresented(b"bad"))
    assert len(grants._budgets._buckets) <= 4


def test_a_renewed_identity_moves_the_end(grants: RenewedGrants) -> None:
    made = opened(grants)
    made.decision = decision(NOW + 5000)
    made.stream.peer.not_after = NOW + 3000
    made.stream.tell(IdentityRenewed(made.stream.peer))
    assert (made.ends, made.stream.reasons) == (NOW + 3000, ["identity"])


def test_a_refused_certificate_is_logged(grants: RenewedGrants, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    opened(grants).stream.tell(PresentedRenewalRefused(IdentityRefused("of another node")))
    assert "/viewer (/word) presents a certificate that is refused: of another node" in caplog.text


def test_own_grants_are_presented_when_they_change(grants: RenewedGrants, access: Access) -> None:
    made = opened(grants)
    grants.present([made], 1, NOW)
    grants.present([made], 1, NOW)
    grants.present([made], 2, NOW + 1)
    assert made.stream.presented == [access.own], "once, and the same again never"
    first, access.own = access.own, encode([b"renewed"])
    grants.present([made], 3, NOW + 1)
    assert made.stream.presented == [first], f"{PACE} s have not passed"
    grants.present([made], 3, NOW + PACE)
    assert made.stream.presented == [first, access.own]


def test_a_connection_that_began_with_them_is_not_told_again(grants: RenewedGrants) -> None:
    grants.present([], 1, NOW - 100)
    made = opened(grants)
    grants.present([made], 1, NOW)
    assert made.stream.presented == []
    grants.present([made], 2, NOW)
    assert len(made.stream.presented) == 1


def test_nothing_is_presented_where_there_is_nothing(grants: RenewedGrants, access: Access) -> None:
    deaf, made = opened(grants), opened(grants)
    deaf.stream.takes = False
    grants.present([deaf], 1, NOW)
    for version, access.own in ((2, b""), (3, encode([]))):
        grants.present([made], version, NOW)
    assert made.stream.presented == deaf.stream.presented == []
