"""The API of a node in a rospy process: calls of others in steps, one of them at a time."""

from collections.abc import Generator
from threading import Lock, Thread

import pytest

from rossec.errors import XmlRpcRefused
from rossec.inprocess.xmlrpc_calls import _load, in_steps
from rossec.net.limits import UNSHOWN_BODY
from rossec.ros.calls import CallClient, CallServer
from rossec.ros.http import Oversized


def steps(seen: list[str], name: str) -> Generator[None, None, str]:
    for _ in range(5):
        seen.append(name)
        yield
    return name


def test_of_those_with_one_turn_one_is_parsed_at_a_time() -> None:
    seen: list[str] = []
    done: list[str] = []
    turn = Lock()
    threads = [
        Thread(target=lambda each=each: done.append(in_steps(steps(seen, each), turn))) for each in "abc"
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(done) == ["a", "b", "c"]
    runs = [name for at, name in enumerate(seen) if at == 0 or seen[at - 1] != name]
    assert sorted(runs) == ["a", "b", "c"], "none came between the steps of another"


def test_a_parser_that_fails_gives_the_turn_back() -> None:
    def failing() -> Generator[None, None, None]:
        yield
        raise XmlRpcRefused("malformed")

    turn = Lock()
    with pytest.raises(XmlRpcRefused):
        in_steps(failing(), turn)
    assert turn.acquire(timeout=5)


def request(size: int) -> tuple[CallServer, bytes | Oversized]:
    server = CallServer(compact=False)
    taken = server.take(CallClient("x", compact=False).request("paramUpdate", ("/x", ["y"] * size)))
    assert taken is not None
    return server, taken


@pytest.mark.parametrize("master", [True, False])
@pytest.mark.parametrize("size", [1, 1000])
def test_short_calls_and_the_masters_are_loaded_as_others_are(size: int, *, master: bool) -> None:
    server, taken = request(size)
    call = _load(server, taken, master=master)
    assert (call.method, call.params) == ("paramUpdate", ("/x", ["y"] * size))


def test_the_master_alone_may_send_long_ones() -> None:
    server, taken = request(UNSHOWN_BODY // 10)
    assert _load(server, taken, master=True).method == "paramUpdate"
    with pytest.raises(XmlRpcRefused, match="has shown no grant"):
        _load(server, taken, master=False)
