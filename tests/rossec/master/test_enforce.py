"""What a lost right takes with it."""

from grants.model import Right
from rossec.master.enforce import enforce
from rossec.master.registry import Kind, NodeRef, PublishersChanged, Registry
from tests.rossec.master.fakes import FakeStatements, caller

A, B = NodeRef("/a", "http://h:1/", b"/a"), NodeRef("/b", "http://h:2/", b"/b")


def registry() -> Registry:
    registry = Registry()
    registry.register_publisher("/t", "*", A)
    registry.register_publisher("/u", "*", A)
    registry.register_service("/s", "rosrpc://h:3", A)
    registry.register_parameter("/p/", A)
    registry.register_subscriber("/t", "*", B)
    return registry


BOTH = {
    "/a": caller("/a", {"/t": Right.PUBLISH, "/u": Right.PUBLISH, "/s": Right.PROVIDE}),
    "/b": caller("/b", {"/t": Right.SUBSCRIBE}),
}


def test_nothing_goes_while_the_rights_hold() -> None:
    state = registry()
    assert enforce(state, FakeStatements(dict(BOTH)), 0) == []
    assert len(list(state.nodes())) == 2


def test_only_what_lost_its_right_goes() -> None:
    state = registry()
    callers = {**BOTH, "/a": caller("/a", {"/u": Right.PUBLISH, "/t": Right.SUBSCRIBE})}
    assert enforce(state, FakeStatements(callers), 0) == [PublishersChanged("/t", (B,), ())]
    assert state.keys_of("/a", Kind.PUBLISHER) == ("/u",)
    assert state.service_uri("/s") is None


def test_a_revoked_node_goes_with_all_it_registered() -> None:
    state = registry()
    events = enforce(state, FakeStatements({"/b": BOTH["/b"]}), 0)
    assert PublishersChanged("/t", (B,), ()) in events
    assert [node.name for node in state.nodes()] == ["/b"]
    assert state.members(Kind.PARAMETER, "/p/") == ()
