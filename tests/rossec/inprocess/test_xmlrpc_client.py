"""Calls of rospy to other nodes: what a hostile one answers is parsed in steps."""

from types import SimpleNamespace
from typing import Any

import pytest

from rossec.errors import XmlRpcRefused
from rossec.ros.calls import CallClient, CallServer
from rossec.ros.http import Oversized
from rossec.ros.xmlrpc import Encoded, Fault

pytestmark = pytest.mark.ros

module = pytest.importorskip("rossec.inprocess.xmlrpc_calls")
server = pytest.importorskip("rossec.inprocess.xmlrpc_calls")
MANY = [1, "", [1] * 30_000]


class HostileAnswers:
    """A stream whose peer answers each call with `value`."""

    def __init__(self, value: object, *, compact: bool) -> None:
        self._calls = CallServer(compact=compact)
        self._value = value
        self._answer = b""

    def settimeout(self, _: float | None) -> None:
        """Nothing waits here."""

    def sendall(self, data: bytes) -> None:
        request = self._calls.take(data)
        assert request is not None
        assert not isinstance(request, Oversized)
        self._calls.load(request)
        self._answer = self._calls.respond(self._value)

    def receive_unit(self) -> bytes:
        return self._answer


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """How long each pause was wanted."""
    found: list[float] = []
    monkeypatch.setattr(server, "time", SimpleNamespace(sleep=found.append, monotonic=lambda: 0.0))
    return found


@pytest.mark.parametrize("compact", [True, False])
def test_a_long_answer_is_parsed_with_pauses(pauses: list[float], compact: bool) -> None:
    """So the threads that publish have the interpreter meanwhile."""
    stream: Any = HostileAnswers(MANY, compact=compact)
    calls = CallClient("x", compact=compact)
    assert module._exchange(stream, calls, "requestTopic", ("/a", "/t", [])) == MANY
    assert calls.is_compact is compact
    assert len(pauses) > 10
    assert not module._parsing.locked()


def test_a_short_answer_is_parsed_at_once(pauses: list[float]) -> None:
    stream: Any = HostileAnswers([1, "", 7], compact=False)
    calls = CallClient("x", compact=False)
    assert module._exchange(stream, calls, "getPid", ("/a",)) == [1, "", 7]
    assert pauses == []


@pytest.mark.parametrize(
    ("answer", "error"),
    [(Fault(1, "no" * 5000), Fault), (Encoded(b"<x>" + b" " * 100_000 + b"</y>"), XmlRpcRefused)],
)
def test_a_long_answer_that_is_none_is_refused(
    pauses: list[float], answer: object, error: type[Exception]
) -> None:
    stream: Any = HostileAnswers(answer, compact=False)
    with pytest.raises(error):
        module._exchange(stream, CallClient("x", compact=False), "getPid", ("/a",))
    assert not module._parsing.locked()


class Process:
    """What a secured process says, and whether it may see the graph."""

    def __init__(self, *, sees_all: bool = False) -> None:
        self.said: list[str] = []
        self.reporter = SimpleNamespace(warn=self.said.append)
        self.registrations = SimpleNamespace(record=lambda *_: None)
        access = SimpleNamespace(holds=lambda *_: sees_all)
        identity = SimpleNamespace(name="/robot")
        self.local_identity = SimpleNamespace(name="/robot", access=access, identity=identity)


def test_what_rospy_keeps_to_itself_is_said() -> None:
    """`rospy.set_param` drops the answer; an empty graph looks like one without topics."""
    process = Process()
    client = module.XmlRpcClient(process)
    refused = [-1, "ERROR: parameter [key] contains illegal chars", 0]
    assert client._record_answer("setParam", ("/robot", "/t\u00fcr", 1), refused) == refused
    [line] = process.said
    assert line.startswith("the master refuses setParam: '/t\\xfcr' is not an absolute ROS name")
    assert "for example /tur: " in line
    client._record_answer("getPublishedTopics", ("/robot", ""), [1, "", []])
    [line] = process.said[1:]
    assert line.startswith("getPublishedTopics: nothing that /robot may see; ")
    assert line.endswith("rossec grant sign /robot --graph")


def test_what_is_in_order_is_not_said() -> None:
    process = Process(sees_all=True)
    client = module.XmlRpcClient(process)
    client._record_answer("getPublishedTopics", ("/robot", ""), [1, "", []])
    client._record_answer("setParam", ("/robot", "/x", 1), [1, "", 0])
    client._record_answer("getParam", ("/robot", "/x"), [-1, "not set", 0])
    assert process.said == []
