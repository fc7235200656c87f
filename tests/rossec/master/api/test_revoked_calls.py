"""The calls that a revoked identity may still make."""

import pytest

from rossec.errors import HangUp
from rossec.master.api.dispatch import (
    MAX_BELOW_INTERMEDIATE,
    MAX_CALLS,
    MAX_CONNECTIONS,
    RevokedCalls,
    RevokedConnections,
)
from rossec.master.api.statement_calls import PROOF_LIMIT
from tests.rossec.master.fakes import FakeStatements


class TreeInForce(FakeStatements):
    """Statements with a tree in force."""

    def current(self, now: int) -> tuple[bytes, bytes]:
        return b"list", b"timestamp of %d" % now

    def proofs(self, entries: object) -> list[bytes]:
        assert isinstance(entries, list)
        return [b"proof"] * len(entries)


def answer_revoked(method: str, params: tuple[object, ...]) -> list[object]:
    return RevokedCalls(TreeInForce(), lambda: 7).answer(method, params, None)


@pytest.mark.parametrize(
    ("method", "params"),
    [("rossec.revocations", ("/eve",)), ("rossec.revocationsSince", ("/eve", b"digest"))],
)
def test_the_whole_list_is_sent_without_a_timestamp(method: str, params: tuple[object, ...]) -> None:
    assert answer_revoked(method, params) == [1, "revocations", [b"list", b""]]


def test_proofs_are_limited_as_for_other_callers() -> None:
    entries: list[object] = [bytes(32), "no entry", *[bytes(32)] * PROOF_LIMIT]
    [code, status, proofs] = answer_revoked("rossec.revocationProofs", ("/eve", entries))
    assert (code, status) == (1, "proofs")
    assert proofs == [b"proof"] * (PROOF_LIMIT - 1)


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("rossec.revocations", ()),
        ("rossec.revocations", (b"/eve",)),
        ("rossec.revocationProofs", ("/eve",)),
        ("rossec.revocationProofs", ("/eve", b"entry")),
        ("rossec.trl", ("/eve", b"")),
        ("system.multicall", ([],)),
        ("getPid", ("/eve",)),
    ],
)
def test_any_other_call_ends_the_connection(method: str, params: tuple[object, ...]) -> None:
    with pytest.raises(HangUp, match="the identity is revoked"):
        answer_revoked(method, params)


def test_connections_are_limited_for_each_identity_and_each_intermediate() -> None:
    connections, one = RevokedConnections(), (b"one", b"above")
    assert [connections.admit(one) for _ in range(MAX_CONNECTIONS + 1)] == [True] * MAX_CONNECTIONS + [False]
    others = [(b"%d" % number, b"above") for number in range(MAX_BELOW_INTERMEDIATE)]
    assert sum(map(connections.admit, others)) == MAX_BELOW_INTERMEDIATE - MAX_CONNECTIONS
    assert connections.admit((b"elsewhere",))
    connections.release(one)
    assert connections.admit(one)
    assert not connections.admit(others[-1])


def test_calls_on_one_connection_are_limited() -> None:
    calls = RevokedCalls(TreeInForce(), lambda: 7)
    for _ in range(MAX_CALLS):
        assert calls.answer("rossec.revocations", ("/eve",), None)[2] == [b"list", b""]
    with pytest.raises(HangUp, match="has been sent the list"):
        calls.answer("rossec.revocations", ("/eve",), None)
