"""Which messages each subscriber is sent, with transports that only record them."""

from io import BytesIO
from types import SimpleNamespace
from typing import Any

import pytest

from grants.errors import GrantError
from rossec.participant.delivery_options import Sample
from tests.rossec.net.test_forks import in_child
from tests.support.rosconnection import transport

pytestmark = pytest.mark.ros

publishing = pytest.importorskip("rossec.inprocess.publishing")
exceptions = pytest.importorskip("rospy.exceptions")


def test_a_connection_without_a_right_gets_nothing() -> None:
    bare, ended = transport(), transport(SimpleNamespace(ends=0, guard=None))
    sent: list[bytes] = []
    for made in (bare, ended):
        made.write_data = sent.append
    assert publishing._send(topic(), Sample(b"\1\0\0\0a"), [bare, ended]) == []
    assert sent == []
    broken = SimpleNamespace(socket=None)
    assert publishing._send(topic(), Sample(b"\1\0\0\0a"), [broken]) == [broken]


def test_a_child_of_a_started_node_says_that_nobody_receives_it() -> None:
    said: list[str] = []

    def in_vain() -> object:
        return publishing.publish(topic(resolved_name="/word"), "x"), said

    node = publishing.forked_node
    assert not node.is_child
    node.start(said.append)
    try:
        result = in_child(in_vain)
    finally:
        node.start(None)
    assert result.startswith("(False, ['this process was forked from a running node")
    assert not node.is_child
    assert not said


class Guard:
    """Filters every message alike, and records them."""

    def __init__(self, key: str, *pieces: bytes, error: GrantError | None = None) -> None:
        self.key = key
        self.pieces: Any = pieces or None
        self.error = error
        self.seen: list[bytes] = []

    memory = None

    def apply(self, message: memoryview, _now: int, _mark: object) -> Any:
        self.seen.append(bytes(message))
        if self.error is not None:
            raise self.error
        return self.pieces


def guarded(guard: Guard, sent: list[Any]) -> Any:
    stream = SimpleNamespace(peer=SimpleNamespace(name="/viewer"))
    made = transport(SimpleNamespace(ends=1 << 40, guard=guard, stream=stream))
    made.write_data = sent.append
    return made


def test_a_guard_that_is_replaced_meanwhile_filters_for_nobody_else() -> None:
    """Under the key of the one before, others would be sent what the new one lets pass."""
    sent: list[Any] = []
    wide = Guard("wide", b"secret")

    class Replaced(Guard):
        @property
        def key(self) -> str:
            first.socket.connection.guard = wide
            return "coarse"

        @key.setter
        def key(self, _: str) -> None:
            pass

    first = guarded(Replaced("coarse", b"a"), sent)
    assert not publishing._send(topic(), Sample(b"\1\0\0\0m"), [first, guarded(Guard("coarse", b"a"), sent)])
    assert sent == [b"\1\0\0\0a"] * 2


def test_each_filter_is_applied_once() -> None:
    coarse, large = Guard("coarse", b"a", b"bc"), Guard("large", bytes(200_000), b"d")
    sent: list[Any] = []
    connections = [guarded(guard, sent) for guard in (coarse, large, coarse)]
    assert publishing._send(topic(), Sample(b"\1\0\0\0m"), connections) == []
    small = b"\3\0\0\0abc"
    assert sent == [small, ((200_001).to_bytes(4, "little"), bytes(200_000), b"d"), small]
    assert coarse.seen == large.seen == [b"m"], "without its length"


def test_a_message_without_content_or_with_an_error_is_withheld(caplog: pytest.LogCaptureFixture) -> None:
    sent: list[Any] = []
    nothing, failing = Guard("nothing"), Guard("failing", error=GrantError("a NaN"))
    connections = [guarded(guard, sent) for guard in (nothing, failing)]
    for _ in range(3):
        assert publishing._send(topic(), Sample(b"\1\0\0\0m"), connections) == []
    assert sent == []
    assert caplog.text.count("/x: withheld from /viewer: a NaN") == 1


def test_nothing_is_sent_while_the_node_shuts_down(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publishing, "is_shutdown", lambda: True)
    sent: list[Any] = []
    subscriber = transport(SimpleNamespace(ends=1 << 40, guard=None))
    subscriber.write_data = sent.append
    made = topic(connections=[subscriber], is_latch=False)
    publishing.publish(made, message())
    made.closed = True
    publishing.publish(made, message())
    made.closed = False

    def close() -> bool:
        made.closed = True
        made.buff.inner.close()
        return True

    made.has_connections = close
    publishing.publish(made, message())
    assert sent == []


class Buffer:
    """As rospy's topics have one."""

    def __init__(self) -> None:
        self.inner = BytesIO()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)


def topic(**changes: Any) -> Any:
    made: Any = SimpleNamespace(
        closed=False,
        is_latch=True,
        latch=None,
        connections=[],
        buff=Buffer(),
        seq=0,
        message_data_sent=0,
        resolved_name="/x",
        has_connections=lambda: bool(made.connections),
    )
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def message(data: str = "hello") -> Any:
    return pytest.importorskip("std_msgs.msg").String(data)


def test_publish_behaves_as_rospys() -> None:
    made = topic()
    assert publishing.publish(made, message()) is False
    assert made.latch.data == "hello"
    dead: Any = SimpleNamespace(socket=None, close=lambda: made.connections.remove(dead))
    made.connections = [dead]
    assert publishing.publish(made, message()) is None
    assert made.connections == []
    assert made.message_data_sent == 13
    one = SimpleNamespace(socket=None, close=lambda: None)
    made.connections = [one]
    publishing.publish(made, message(), connection_override=one)
    made.closed = True
    with pytest.raises(exceptions.ROSException, match="closed topic"):
        publishing.publish(made, message())


def test_memory_of_large_messages_is_reused() -> None:
    got: list[bytes] = []
    subscriber = transport(SimpleNamespace(ends=1 << 40, guard=None))
    subscriber.write_data = got.append
    made = topic(connections=[subscriber])
    made.buff = first = BytesIO()
    for letter in "ab":
        publishing.publish(made, message(letter * 200_000))
    assert made.buff is not first, "its bytes are still referenced"
    assert [data[8:] for data in got] == [b"a" * 200_000, b"b" * 200_000]
    got.clear()
    publishing.publish(made, message("c" * 150_000))
    assert made.buff is first
    for text in ("short", "", "d" * 200_000):
        publishing.publish(made, message(text))
    assert [data[8:] for data in got] == [b"c" * 150_000, b"short", b"", b"d" * 200_000]


def test_publishing_to_a_topic_closed_meanwhile_raises() -> None:
    made = topic(connections=[transport()])
    made.buff.inner.close()
    with pytest.raises(ValueError, match="closed file"):
        publishing.publish(made, message())

    def close() -> bool:
        made.closed = True
        return True

    made.has_connections = close
    with pytest.raises(exceptions.ROSException, match=r"during publish"):
        publishing.publish(made, message())
