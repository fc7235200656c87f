"""The registry: events, replacement, versions, invariants under any sequence of calls."""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from rossec.master.state.registry import (
    REGISTRATIONS_LIMIT,
    Kind,
    NodeRef,
    PublishersChanged,
    Registry,
    ShutdownNode,
    Unregistered,
)

A, B, C = (
    NodeRef("/a", "http://h:1/", b"/a"),
    NodeRef("/b", "http://h:2/", b"/b"),
    NodeRef("/c", "http://h:3/", b"/c"),
)
TYPE = "std_msgs/String"


def test_a_publisher_is_announced_to_the_subscribers() -> None:
    registry = Registry()
    assert registry.register_subscriber("/t", "*", A) == []
    assert registry.register_publisher("/t", TYPE, B) == [PublishersChanged("/t", (A,), (B.uri,))]
    assert registry.register_publisher("/t", TYPE, C) == [PublishersChanged("/t", (A,), (B.uri, C.uri))]
    assert registry.uris(Kind.PUBLISHER, "/t") == [B.uri, C.uri]


def test_unregistering_is_announced_once() -> None:
    registry = Registry()
    registry.register_subscriber("/t", "*", A)
    registry.register_publisher("/t", TYPE, B)
    done, events = registry.unregister(Kind.PUBLISHER, "/t", B)
    assert done == Unregistered("Unregistered [/b] as provider of [/t]", 1)
    assert events == [PublishersChanged("/t", (A,), ())]
    assert registry.unregister(Kind.PUBLISHER, "/t", B) == (
        Unregistered("[/b] is not a registered node", 0),
        [],
    )
    assert registry.unregister(Kind.SUBSCRIBER, "/t", A)[1] == []
    assert list(registry.nodes()) == []


def test_unregistering_needs_the_registered_uri() -> None:
    registry = Registry()
    registry.register_publisher("/t", TYPE, A)
    done, events = registry.unregister(Kind.PUBLISHER, "/t", NodeRef("/a", "http://other:1/", b"/a"))
    assert done == Unregistered("[/a] is not a known provider of [/t]", 0)
    assert events == []


def test_a_node_with_a_new_uri_replaces_the_old_one() -> None:
    registry = Registry()
    registry.register_subscriber("/t", "*", B)
    registry.register_publisher("/t", TYPE, A)
    registry.register_service("/s", "rosrpc://h:9", A)
    new = NodeRef("/a", "http://h:7/", b"/a")
    assert registry.register_subscriber("/u", "*", new) == [
        PublishersChanged("/t", (B,), ()),
        ShutdownNode(A, "new node registered with same name"),
    ]
    assert registry.node_uri("/a") == new.uri
    assert registry.service_uri("/s") is None
    assert registry.owner(A.uri) is None
    assert registry.owner(new.uri) == "/a"


def test_another_key_of_the_same_name_touches_nothing() -> None:
    registry = Registry()
    registry.register_publisher("/t", TYPE, A)
    registry.register_parameter("/p/", A)
    registry.register_service("/s", "rosrpc://h:1", A)
    other = A._replace(thumbprint=b"another key")
    before = registry.version
    for kind, key in ((Kind.PUBLISHER, "/t"), (Kind.PARAMETER, "/p/")):
        done, events = registry.unregister(kind, key, other)
        assert (done.removed, events) == (0, [])
    done = registry.unregister_service("/s", A.name, "rosrpc://h:1", other.thumbprint)
    assert done == Unregistered("[/a] is not a registered node", 0)
    assert registry.version == before
    assert registry.is_current(A)
    assert not registry.is_current(other)


def test_another_key_that_registers_replaces_the_node() -> None:
    registry = Registry()
    registry.register_subscriber("/t", "*", B)
    registry.register_publisher("/t", TYPE, A)
    other = A._replace(thumbprint=b"another key")
    assert registry.register_publisher("/u", TYPE, other)[:-1] == [PublishersChanged("/t", (B,), ())]
    assert registry.is_current(other)
    assert registry.owner(A.uri) == "/a"


def test_the_last_provider_replaces_the_others() -> None:
    registry = Registry()
    registry.register_service("/s", "rosrpc://h:1", A)
    registry.register_service("/s", "rosrpc://h:2", B)
    assert registry.service_uri("/s") == "rosrpc://h:2"
    assert registry.node_uri("/a") is None
    assert registry.unregister_service("/s", "/b", "rosrpc://h:1", b"/b").removed == 0
    assert registry.unregister_service("/s", "/b", "rosrpc://h:2", b"/b").removed == 1


def test_a_type_replaces_the_wildcard_type() -> None:
    registry = Registry()
    registry.register_subscriber("/t", "*", A)
    assert list(registry.topic_types()) == []
    assert registry.topic_type("/t") == "*"
    registry.register_publisher("/t", "*", B)
    registry.register_publisher("/t", TYPE, B)
    registry.register_publisher("/t", "*", C)
    assert registry.topic_type("/t") == TYPE


def test_a_type_is_removed_with_the_last_registration() -> None:
    registry = Registry()
    registry.register_publisher("/t", TYPE, A)
    registry.register_subscriber("/t", TYPE, B)
    registry.register_service("/t", "rosrpc://h:1", B)
    registry.unregister(Kind.PUBLISHER, "/t", A)
    assert list(registry.topic_types()) == [("/t", TYPE)]
    registry.unregister(Kind.SUBSCRIBER, "/t", B)
    assert list(registry.topic_types()) == []


def test_the_registrations_of_a_node_are_limited() -> None:
    registry = Registry()
    for n in range(REGISTRATIONS_LIMIT):
        assert registry.has_capacity(Kind.PUBLISHER, f"/t{n}", A)
        registry.register_publisher(f"/t{n}", TYPE, A)
    assert registry.has_capacity(Kind.PUBLISHER, "/t0", A)
    assert not registry.has_capacity(Kind.PUBLISHER, "/more", A)
    assert registry.has_capacity(Kind.SUBSCRIBER, "/more", A)
    assert registry.has_capacity(Kind.PUBLISHER, "/more", B)
    assert registry.has_capacity(Kind.PUBLISHER, "/more", A._replace(uri="http://h:9/"))


def test_the_nodes_of_a_key_are_limited() -> None:
    registry = Registry(2)
    one, two, three = (A._replace(name=f"/a_{n}", uri=f"http://h:{n + 9}/") for n in range(3))
    registry.register_publisher("/t", TYPE, one)
    registry.register_parameter("/t", two)
    assert registry.has_capacity(Kind.SUBSCRIBER, "/t", two)
    assert not registry.has_capacity(Kind.PUBLISHER, "/t", three)
    assert not registry.has_capacity(Kind.PUBLISHER, "/t", B._replace(thumbprint=A.thumbprint))
    moved = two._replace(uri="http://h:99/")
    assert registry.has_capacity(Kind.PUBLISHER, "/t", moved)
    registry.register_publisher("/t", TYPE, moved)  # it is still one of two
    assert not registry.has_capacity(Kind.PUBLISHER, "/t", three)
    assert registry.has_capacity(Kind.PUBLISHER, "/t", three._replace(thumbprint=b"another key"))
    registry.remove_node(one.name)
    assert registry.has_capacity(Kind.PUBLISHER, "/t", three)
    newer = moved._replace(thumbprint=b"a newer key")
    registry.register_publisher("/t", TYPE, newer)
    registry.register_publisher("/t", TYPE, one)
    assert registry.has_capacity(Kind.PUBLISHER, "/t", three)


def test_an_address_is_found_in_any_spelling() -> None:
    registry = Registry()
    registry.register_publisher("/t", TYPE, A._replace(uri="http://[::1]:80/"))
    assert registry.owner("http://[0::1]:080") == "/a"
    registry.remove_node("/a")
    assert registry.owner("http://[::1]:80/") is None


def test_removing_a_node_notifies_its_subscribers() -> None:
    registry = Registry()
    registry.register_publisher("/t", TYPE, A)
    registry.register_parameter("/p/", A)
    registry.register_subscriber("/t", TYPE, B)
    assert registry.remove_node("/a") == [PublishersChanged("/t", (B,), ())]
    assert registry.remove_node("/a") == []
    assert registry.registered_nodes(Kind.PARAMETER, "/p/") == ()


def test_removing_one_registration() -> None:
    registry = Registry()
    registry.register_publisher("/t", TYPE, A)
    registry.register_subscriber("/t", TYPE, A)
    assert registry.remove(Kind.SUBSCRIBER, "/t", "/a") == []
    assert registry.remove(Kind.SUBSCRIBER, "/t", "/a") == []
    assert registry.remove(Kind.PUBLISHER, "/t", "/a") == [PublishersChanged("/t", (), ())]
    assert registry.keys_of("/a", Kind.PUBLISHER) == ()


def test_a_node_is_silent_until_it_answers_or_goes() -> None:
    registry = Registry()
    assert not registry.set_silent(A, silent=True)  # not registered
    registry.register_publisher("/t", TYPE, A)
    version = registry.version
    assert registry.set_silent(A, silent=True)
    assert not registry.set_silent(A, silent=True)
    assert registry.is_silent(A)
    assert registry.silent_names == {"/a"}
    assert registry.version == version + 1
    assert not registry.set_silent(B._replace(name="/a"), silent=False)
    assert registry.set_silent(A, silent=False)
    assert not registry.is_silent(A)
    registry.set_silent(A, silent=True)
    registry.remove_node("/a")
    registry.register_publisher("/t", TYPE, A)
    assert not registry.is_silent(A)


def test_version_grows_only_with_changes() -> None:
    registry = Registry()
    registry.register_publisher("/t", TYPE, A)
    before = registry.version
    registry.register_publisher("/t", TYPE, A)
    registry.unregister(Kind.SUBSCRIBER, "/t", A)
    assert registry.version == before
    registry.register_service("/s", "rosrpc://h:1", A)
    middle = registry.version
    registry.register_service("/s", "rosrpc://h:2", A)
    assert before < middle < registry.version


refs = st.sampled_from(
    [NodeRef(n, f"http://{n[1:]}:{p}/", k) for n in ("/a", "/b") for p in (1, 2) for k in (b"k", b"l")]
)
topics = st.sampled_from(["/t", "/u"])


class Machine(RuleBasedStateMachine):
    """After any calls, subscribers know the publishers and the indices agree."""

    def __init__(self) -> None:
        super().__init__()
        self.registry = Registry()
        self.known: dict[tuple[str, str], tuple[str, ...]] = {}

    def deliver(self, events: object) -> None:
        assert isinstance(events, list)
        for event in events:
            if isinstance(event, PublishersChanged):
                for node in event.subscribers:
                    self.known[event.topic, node.uri] = event.publisher_uris

    @rule(topic=topics, ref=refs)
    def publish(self, topic: str, ref: NodeRef) -> None:
        self.deliver(self.registry.register_publisher(topic, TYPE, ref))

    @rule(topic=topics, ref=refs)
    def subscribe(self, topic: str, ref: NodeRef) -> None:
        self.deliver(self.registry.register_subscriber(topic, TYPE, ref))
        self.known[topic, ref.uri] = tuple(self.registry.uris(Kind.PUBLISHER, topic))

    @rule(topic=topics, ref=refs)
    def provide(self, topic: str, ref: NodeRef) -> None:
        self.deliver(self.registry.register_service(topic, f"rosrpc://{ref.name}", ref))

    @rule(kind=st.sampled_from(list(Kind)), topic=topics, ref=refs)
    def unregister(self, kind: Kind, topic: str, ref: NodeRef) -> None:
        if kind is Kind.SERVICE:
            self.registry.unregister_service(topic, ref.name, f"rosrpc://{ref.name}", ref.thumbprint)
        else:
            self.deliver(self.registry.unregister(kind, topic, ref)[1])

    @rule(ref=refs)
    def remove(self, ref: NodeRef) -> None:
        self.deliver(self.registry.remove_node(ref.name))
        assert ref.name not in {
            name for kind in Kind for _, names in self.registry.entries(kind) for name in names
        }

    @invariant()
    def subscribers_know_the_publishers(self) -> None:
        for topic in ("/t", "/u"):
            for uri in self.registry.uris(Kind.SUBSCRIBER, topic):
                assert self.known[topic, uri] == tuple(self.registry.uris(Kind.PUBLISHER, topic))

    @invariant()
    def indices_agree(self) -> None:
        listed = {n for kind in Kind for _, names in self.registry.entries(kind) for n in names}
        assert {node.name for node in self.registry.nodes()} == listed
        for node in self.registry.nodes():
            assert self.registry.owner(node.uri) == node.name


Machine.TestCase.settings = settings(max_examples=50, stateful_step_count=20)
TestMachine = Machine.TestCase
