"""Registrations are removed when no right covers them."""

from dataclasses import replace

import pytest

from grants.model import Right
from rossec.master.api.methods import MasterEvent
from rossec.master.rights.statements import BATCH, EnforcementStep, enforce, enforcement_steps
from rossec.master.state.registry import Kind, NodeRef, PublishersChanged, Registry
from tests.rossec.master.fakes import FakeStatements, caller
from tests.rossec.master.rights.test_caller import visitor_of

A, B = NodeRef("/a", "http://h:1/", b"/a"), NodeRef("/b", "http://h:2/", b"/b")


def enforce_all(state: Registry, statements: FakeStatements) -> list[MasterEvent]:
    return [event for step in enforcement_steps(state) for event in enforce(state, statements, step, 0)]


def registry() -> Registry:
    registry = Registry()
    registry.register_publisher("/t", "*", A)
    registry.register_publisher("/u", "*", A)
    registry.register_service("/s", "rosrpc://h:3", A)
    registry.register_parameter("/p/", A)
    registry.register_subscriber("/t", "*", B)
    return registry


BOTH = {
    "/a": caller(
        "/a", {"/t": Right.PUBLISH, "/u": Right.PUBLISH, "/s": Right.PROVIDE, "/p/one": Right.PARAM_GET}
    ),
    "/b": caller("/b", {"/t": Right.SUBSCRIBE}),
}


def test_nothing_is_removed_while_grants_are_valid() -> None:
    state = registry()
    assert enforce_all(state, FakeStatements(dict(BOTH))) == []
    assert len(list(state.nodes())) == 2
    assert state.registered_nodes(Kind.PARAMETER, "/p/") == (A,)


def test_only_uncovered_registrations_are_removed() -> None:
    state = registry()
    callers = {**BOTH, "/a": caller("/a", {"/u": Right.PUBLISH, "/t": Right.SUBSCRIBE})}
    assert enforce_all(state, FakeStatements(callers)) == [PublishersChanged("/t", (B,), ())]
    assert state.keys_of("/a", Kind.PUBLISHER) == ("/u",)
    assert state.service_uri("/s") is None
    assert state.registered_nodes(Kind.PARAMETER, "/p/") == ()


@pytest.mark.parametrize("right", Right)
def test_each_registration_needs_its_own_right(right: Right) -> None:
    state = registry()
    state.register_subscriber("/x", "*", A)
    rights = dict.fromkeys(("/t", "/u", "/s", "/p/one", "/x"), right)
    enforce_all(state, FakeStatements({**BOTH, "/a": caller("/a", rights)}))
    left = {kind for kind in Kind if state.keys_of("/a", kind)}
    own = {
        Right.PUBLISH: Kind.PUBLISHER,
        Right.SUBSCRIBE: Kind.SUBSCRIBER,
        Right.PROVIDE: Kind.SERVICE,
        Right.PARAM_GET: Kind.PARAMETER,
    }
    assert left == ({own[right]} if right in own else set())


def test_a_revoked_node_is_removed_with_its_registrations() -> None:
    state = registry()
    events = enforce_all(state, FakeStatements({"/b": BOTH["/b"]}))
    assert PublishersChanged("/t", (B,), ()) in events
    assert [node.name for node in state.nodes()] == ["/b"]
    assert state.registered_nodes(Kind.PARAMETER, "/p/") == ()


def test_a_step_is_small_and_uses_the_current_state() -> None:
    state = Registry()
    for n in range(BATCH + 1):
        state.register_publisher(f"/t{n}", "*", A)
    first, second = enforcement_steps(state)
    assert (len(first.keys), len(second.keys)) == (BATCH, 1)
    without_callers = FakeStatements()
    assert (
        enforce(state, without_callers, EnforcementStep(A._replace(uri="http://h:9/"), *first[1:]), 0) == []
    )
    assert len(state.keys_of("/a", Kind.PUBLISHER)) == BATCH + 1
    nothing = FakeStatements({"/a": caller("/a")})
    assert len(enforce(state, nothing, second, 0)) == 1
    assert enforce(state, nothing, second, 0) == []
    assert len(state.keys_of("/a", Kind.PUBLISHER)) == BATCH


def test_a_subscriber_of_an_alias_stays_while_it_may_be_served() -> None:
    state, alias = Registry(), "/remote/hospital/pose"
    state.register_subscriber(alias, "*", A)
    served = {"/gateway/hospital/pose": Right.SUBSCRIBE}
    who = replace(visitor_of(own=served), name="/a", thumbprint=b"/a")
    assert enforce_all(state, FakeStatements({"/a": who})) == []
    assert state.is_registered(Kind.SUBSCRIBER, alias, "/a")
    unlisted = replace(who, domain_of=lambda _: None)
    assert enforce_all(state, FakeStatements({"/a": unlisted})) == []
    assert not state.is_registered(Kind.SUBSCRIBER, alias, "/a")
