"""The same calls to Debian's rosmaster and to ours: equal answers, except for listed differences.

Our callers have all rights, so only behaviour differs. Stock's handler runs in process, with a
thread pool that never calls slave APIs.
"""

import os
import xmlrpc.client
from copy import deepcopy
from typing import Any

import pytest

from rossec.master.api.dispatch import MasterApi
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import FakeStatements, call_api, everything, master_api

pytestmark = pytest.mark.ros

A, B, A2 = "http://h:1/", "http://h:2/", "http://h:3/"
S1, S2 = "rosrpc://h:11", "rosrpc://h:12"
T, U = "std_msgs/String", "std_msgs/Bool"
CANNOT, IN_ANSWER = "XML-RPC cannot carry", "in an answer"
Call = tuple[Any, ...]

TABLES: dict[str, list[Call]] = {
    "publish and subscribe": [
        ("registerSubscriber", "/a", "/t", "*", A),
        ("getTopicTypes", "/a"),
        ("registerPublisher", "/b", "/t", T, B),
        ("registerPublisher", "/b", "/t", "*", B),
        ("registerPublisher", "/a", "/t", U, A),
        ("registerSubscriber", "/b", "/t", T, B),
        ("registerSubscriber", "/b", "rel", T, B),
        ("registerSubscriber", "/ns/c", "~priv", T, "http://h:9/"),
        ("getTopicTypes", "/a"),
        ("getPublishedTopics", "/a", ""),
        ("getPublishedTopics", "/a", "/t"),
        ("getSystemState", "/a"),
        ("unregisterPublisher", "/b", "/t", "http://other:1/"),
        ("unregisterPublisher", "/b", "/t", B),
        ("unregisterPublisher", "/b", "/t", B),
        ("unregisterPublisher", "/nobody", "/t", B),
        ("unregisterSubscriber", "/a", "/t", A),
        ("unregisterSubscriber", "/a", "/never", A),
        ("lookupNode", "/a", "/b"),
        ("lookupNode", "/a", "b"),
        ("lookupNode", "/a", "/nobody"),
        ("getSystemState", "/a"),
        ("getTopicTypes", "/a"),
    ],
    "services": [
        ("unregisterService", "/a", "/s", S1),
        ("registerPublisher", "/a", "/t", T, A),
        ("unregisterService", "/a", "/s", S1),
        ("registerService", "/a", "/s", S1, A),
        ("lookupService", "/b", "/s"),
        ("lookupService", "/b", "s"),
        ("lookupService", "/b", "/none"),
        ("registerService", "/b", "/s", S2, B),
        ("lookupService", "/a", "/s"),
        ("unregisterService", "/a", "/s", S1),
        ("unregisterService", "/b", "/s", S1),
        ("getSystemState", "/a"),
        ("unregisterService", "/b", "/s", S2),
        ("lookupService", "/b", "/s"),
        ("getSystemState", "/a"),
    ],
    "the same name twice": [
        ("registerPublisher", "/a", "/t", T, A),
        ("registerService", "/a", "/s", S1, A),
        ("registerSubscriber", "/b", "/t", T, B),
        ("registerPublisher", "/a", "/u", T, A2),
        ("lookupNode", "/b", "/a"),
        ("lookupService", "/b", "/s"),
        ("getSystemState", "/b"),
        ("unregisterPublisher", "/a", "/t", A),
    ],
    "arity and types": [
        (method, *arguments)
        for method in (
            "registerPublisher",
            "registerSubscriber",
            "registerService",
            "unregisterPublisher",
            "unregisterSubscriber",
            "unregisterService",
            "lookupNode",
            "lookupService",
            "getSystemState",
            "getTopicTypes",
            "getPublishedTopics",
            "getPid",
            "getUri",
            "shutdown",
            "getParam",
            "setParam",
            "hasParam",
            "deleteParam",
            "searchParam",
            "getParamNames",
            "subscribeParam",
            "unsubscribeParam",
        )
        for arguments in ((), ("/a", 1, 2, 3, 4, 5), (1,), (1, 2), (1, 2, 3), (1, 2, 3, 4))
    ],
    "wrong arguments": [
        (method, "/a", *arguments)
        for method, count in (
            ("registerPublisher", 3),
            ("registerSubscriber", 3),
            ("registerService", 3),
            ("unregisterPublisher", 2),
            ("unregisterService", 2),
            ("lookupNode", 1),
            ("lookupService", 1),
            ("getPublishedTopics", 1),
            ("getParam", 1),
            ("hasParam", 1),
            ("setParam", 2),
            ("deleteParam", 1),
            ("searchParam", 1),
            ("subscribeParam", 2),
        )
        for arguments in (
            (5, T, A)[:count],
            ("", T, A)[:count],
            ("has space", T, A)[:count],
            (A, T, A)[:count],
            ("/", T, A)[:count],
            ("/t", "", "")[:count],
            ("/t", 7, 7)[:count],
            ("/t", "nonsense", "nonsense")[:count],
            ("/t", T, "nonsense")[:count],
        )
        if not (method == "getPublishedTopics" and arguments in ((A,), ("has space",)))
    ],
    "parameters": [
        ("getParam", "/a", "/x"),
        ("subscribeParam", "/a", A, "/x"),
        ("setParam", "/a", "/x", 1),
        ("setParam", "/ns/a", "x", "text"),
        ("setParam", "/ns/a", "~x", [1, "two", 3.0]),
        ("setParam", "/a", "/tree", {"a": {"b": True, "c": xmlrpc.client.Binary(b"z")}, "e": {}}),
        ("getParam", "/a", "/tree/a"),
        ("getParam", "/a", "/tree/a/b"),
        ("getParam", "/a", "/tree/a/b/too/far"),
        ("getParam", "/a", "//tree//a/"),
        ("getParam", "/a", "/"),
        ("getParamNames", "/a"),
        ("hasParam", "/a", "/tree"),
        ("hasParam", "/ns/a", "x"),
        ("hasParam", "/a", "/none"),
        ("searchParam", "/ns/a", "x"),
        ("searchParam", "/ns/a/deep", "x"),
        ("searchParam", "/ns/a", "tree/zzz"),
        ("searchParam", "/ns/a", "/x"),
        ("searchParam", "/ns/a", "/none"),
        ("searchParam", "/ns/a", "none"),
        ("searchParam", "/ns/a", "~x"),
        ("setParam", "/a", "/x/under", 2),
        ("getParam", "/a", "/x"),
        ("setParam", "/a", "/", 5),
        ("deleteParam", "/a", "/"),
        ("deleteParam", "/a", "/none"),
        ("deleteParam", "/a", "/none/deeper"),
        ("deleteParam", "/a", "/tree/a/b/c"),
        ("deleteParam", "/a", "/tree/a"),
        ("getParam", "/a", "/tree"),
        ("unsubscribeParam", "/a", A, "/x"),
        ("unsubscribeParam", "/a", A, "/x"),
        ("setParam", "/a", "/", {"only": 1}),
        ("getParamNames", "/a"),
    ],
}


# Where ours differs on purpose, by the name under which docs/spec/master.md explains it.
BY_NAME: dict[str, list[tuple[Call, list[Any]]]] = {
    # Stock fails in its own tree walk; the parameter does not exist.
    "delete-below-value": [
        (("deleteParam", "/a", "/tree/a/b/c"), [-1, "parameter [/tree/a/b/c] is not set", 0])
    ],
    # Rights are matched on names, so names must be names.
    "topic-names": [
        (
            ("registerSubscriber", "/a", "/my-topic", "*", A),
            [-1, "ERROR: parameter [topic] contains illegal chars", []],
        ),
        (
            ("registerService", "/a", "/1s", S1, A),
            [-1, "ERROR: parameter [service] contains illegal chars", 0],
        ),
    ],
    "parameter-names": [
        ((method, "/a", *before, key, *after), [-1, "ERROR: parameter [key] contains illegal chars", default])
        for method, before, after, default in (
            ("getParam", (), (), 0),
            ("hasParam", (), (), False),
            ("setParam", (), (T,), 0),
            ("deleteParam", (), (), 0),
            ("subscribeParam", (A,), (), 0),
        )
        for key in ("/my-param", "/a\nb", "has space", A)
    ],
    # Stock finds the tree /http: that setParam made of the URI above.
    "search-odd-names": [
        (("searchParam", "/a", A), [-1, f"Cannot find parameter [{A}] in an upwards search", ""])
    ],
    # The master dials slave APIs: without a port, or at a service's URI, it cannot.
    "undialable-api": [
        (
            ("registerPublisher", "/a", "/t", T, uri),
            [-1, "ERROR: parameter [caller_api] is not an RPC URI", []],
        )
        for uri in ("http://h/", S1)
    ],
    # Stock stores such a name where no getParam finds it.
    "tree-names": [
        (
            ("setParam", "/a", "/y", {"b/c": 1}),
            [-1, "Error: invalid arguments: 'b/c' cannot be the name of a parameter in a tree", 0],
        )
    ],
    # Stock stores it, and then no tree that holds it can be read any more.
    "unreadable-values": [
        (
            ("setParam", "/a", "/big", 1 << 31),
            [-1, f"Error: invalid arguments: {CANNOT} the number 2147483648 {IN_ANSWER}", 0],
        ),
        (("setParam", "/a", "/nil", [None]), [-1, f"Error: invalid arguments: {CANNOT} nil {IN_ANSWER}", 0]),
    ],
    # Stock keeps the type of a topic without publishers and subscribers.
    "types-of-the-gone": [(("getTopicTypes", "/gone"), [1, "current system state", []])],
    # After a service was replaced, stock keeps the old node registered.
    "replaced-provider": [(("lookupNode", "/b", "/old"), [-1, "unknown node [/old]", ""])],
}
DIFFERENCES = [difference for group in BY_NAME.values() for difference in group]
TABLES["differences"] = [
    ("registerService", "/old", "/s", S1, A2),
    ("registerService", "/b", "/s", S2, B),
    ("registerPublisher", "/gone", "/gone/t", T, "http://h:77/"),
    ("unregisterPublisher", "/gone", "/gone/t", "http://h:77/"),
    ("getTopicTypes", "/gone"),
    *[call for call, _ in DIFFERENCES if call not in (DIFFERENCES[0][0], ("getTopicTypes", "/gone"))],
]


class NoPool:
    """Stock's worker threads, which here never call slave APIs."""

    def queue_task(self, *_: object) -> None:
        pass

    def join_all(self, **_: object) -> None:
        pass


@pytest.fixture
def stock() -> Any:
    api = pytest.importorskip("rosmaster.master_api")
    handler = api.ROSMasterHandler(0)
    handler.thread_pool = handler.reg_manager.thread_pool = NoPool()
    handler._ready("http://master:11311/")
    return handler


@pytest.fixture
def ours() -> MasterApi:
    return master_api(
        Registry(), FakeStatements(), name="/master", uri="http://master:11311/", pid=os.getpid()
    )


def plain(value: Any) -> Any:
    """Tuples and lists are the same array on the wire."""
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def wired(value: Any) -> Any:
    """The value as received: base64 is bytes."""
    match value:
        case xmlrpc.client.Binary():
            return value.data
        case dict():
            return {key: wired(below) for key, below in value.items()}
        case list() | tuple():
            return [wired(item) for item in value]
        case _:
            return value


def ask_ours(api: MasterApi, call: Call) -> Any:
    method, *params = wired(call)
    name = params[0] if params and isinstance(params[0], str) else "/a"
    return plain(call_api(api, method, params, everything(name), 0).answer)


@pytest.mark.parametrize("table", TABLES)
def test_same_answers(table: str, stock: Any, ours: MasterApi) -> None:
    for call in TABLES[table]:
        expected = plain(getattr(stock, call[0])(*deepcopy(call[1:])))
        different = [answer for known, answer in DIFFERENCES if known == call]
        assert expected not in different, f"no difference any more: {call}"
        assert ask_ours(ours, deepcopy(call)) == (different[0] if different else expected), call


def test_unknown_methods_are_the_same_fault(stock: Any, ours: MasterApi) -> None:
    from xmlrpc.server import SimpleXMLRPCDispatcher

    server = SimpleXMLRPCDispatcher()
    server.register_instance(stock)
    for method in ("system.listMethods", "nonsense", "_shutdown", "registerPublisher2"):
        with pytest.raises(xmlrpc.client.Fault) as expected:
            xmlrpc.client.loads(server._marshaled_dispatch(xmlrpc.client.dumps((), method)))
        with pytest.raises(xmlrpc.client.Fault) as got:
            call_api(ours, method, [], everything("/a"), 0)
        assert (got.value.faultCode, got.value.faultString) == (
            expected.value.faultCode,
            expected.value.faultString,
        )


def test_multicall_is_the_same(stock: Any, ours: MasterApi) -> None:
    from xmlrpc.server import SimpleXMLRPCDispatcher

    server = SimpleXMLRPCDispatcher()
    server.register_multicall_functions()
    server.register_instance(stock)
    calls: list[Any] = [
        {"methodName": "setParam", "params": ["/a", "/x", 1]},
        {"methodName": "nonsense", "params": []},
        {"methodName": "getParam", "params": ["/a", "/x"]},
        {"methodName": "getParam", "params": []},
    ]
    expected = plain(server.system_multicall(calls))
    assert plain(call_api(ours, "system.multicall", [calls], everything("/a"), 0).answer) == expected
