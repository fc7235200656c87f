"""What may take the place of a guard where messages are forwarded, and what may not."""

from typing import Any

import pytest

from grants.decision import Decision
from grants.errors import GrantError
from grants.guard import Guard, Memory
from grants.model import Restriction, Right
from rossec.errors import ConnectionHeaderRefused
from rossec.sidecar.core.guards import CopyTracker, ReplaceableGuard, Replacing, SharedGuard
from rossec.sidecar.core.node_connections import unrestricted

NOW = 1_800_000_000
NEVER = Restriction(conditions=('now < timestamp("2001-01-01T00:00:00Z")',))
LIMITED = Restriction(rate=1.0)


def decision(*restrictions: Restriction, expires: int = NOW + 10) -> Decision:
    return Decision(Right.SUBSCRIBE, "/word", (), expires, restrictions)


def guard_of(*restrictions: Restriction, memory: Memory | None = None) -> Guard:
    found = memory or Memory()
    return Guard(None, decision(*restrictions), None, lambda _: found)


def rebuild(made: Decision) -> Guard | None:
    return guard_of(*made.restrictions) if made.restrictions else None


def replacing(guard: Any, *, to_peer: bool = True) -> Replacing:
    return Replacing(guard, rebuild, to_peer=to_peer)


def test_a_guard_is_replaced_by_another_and_by_none() -> None:
    guard = ReplaceableGuard(guard_of(NEVER))
    made = replacing(guard)
    assert guard.apply(b"hello", NOW) is None
    made.swap(made.rebuild(decision()))
    assert guard.apply(b"hello", NOW) == [b"hello"]
    made.swap(made.rebuild(decision(NEVER)))
    assert guard.apply(b"hello", NOW) is None


def test_a_guard_without_restrictions_still_ends() -> None:
    guard = ReplaceableGuard(guard_of(NEVER))
    made = replacing(guard)
    made.swap(made.rebuild(decision(expires=NOW + 5)))
    guard.check(NOW + 4)
    with pytest.raises(Exception, match="expired"):
        guard.check(NOW + 5)


def test_bytes_that_pass_unread_cannot_be_restricted() -> None:
    made = replacing(None)
    made.swap(made.rebuild(decision()))
    with pytest.raises(ConnectionHeaderRefused, match="unread"):
        made.rebuild(decision(NEVER))


def test_limits_need_a_connection_whose_messages_do_not_wait() -> None:
    waits = ReplaceableGuard(guard_of(NEVER))
    with pytest.raises(ConnectionHeaderRefused, match="wait"):
        replacing(waits).rebuild(decision(LIMITED))
    assert replacing(waits, to_peer=False).rebuild(decision(LIMITED)) is not None


def test_a_shared_guard_keeps_its_place_among_the_connections_of_its_key() -> None:
    memory = Memory()
    with CopyTracker().share(guard_of(LIMITED, memory=memory), NOW, latching=False) as (guard, _):
        assert isinstance(guard, SharedGuard)
        made = Replacing(guard, lambda made: guard_of(*made.restrictions, memory=memory), to_peer=True)
        passed = [guard.apply(b"%d" % count, NOW) for count in range(5)]
        made.swap(made.rebuild(decision(LIMITED)))
        assert guard.apply(b"one more", NOW) is None, "a renewal fills no bucket again"
        assert any(passed)


def test_services_of_programs_are_unrestricted() -> None:
    unrestricted(decision())
    with pytest.raises(GrantError):
        unrestricted(decision(NEVER))
