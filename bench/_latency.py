"""Latency of publisher updates with dead nodes."""

import asyncio
import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from xmlrpc.server import SimpleXMLRPCServer

from bench._lines import Line, request
from bench._masters import EnrolledNode, Master, enroll
from bench._population import TYPE
from ca.certificates import Identity
from grants.model import Right
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect, serve
from rossec.net.rpc import RpcClient, serve_calls
from tests.support.site import Site

TOPIC = "/shared/t"
ROUNDS = 30
GIVE_UP = 2.0  # seconds; what takes longer is reported as this
KIND = "std_msgs/String"


@contextlib.contextmanager
def silent_port() -> Iterator[int]:
    """A port that accepts connections and never answers."""
    with socket.create_server(("0.0.0.0", 0), backlog=256) as sock:
        yield sock.getsockname()[1]


class _Calls:
    """Counts the calls of a slave API, and lets another thread wait for them."""

    def __init__(self) -> None:
        self.condition = threading.Condition()
        self.at: list[float] = []

    def __call__(self, *_: object) -> list[object]:
        with self.condition:
            self.at.append(time.perf_counter())
            self.condition.notify_all()
        return [1, "", 0]

    def wait(self, count: int) -> float:
        with self.condition:
            self.condition.wait_for(lambda: len(self.at) >= count, GIVE_UP)
            return self.at[count - 1] if len(self.at) >= count else float("inf")


def plain_updates(master: Master, dead: int) -> float:
    """Median milliseconds from a registration to the live subscriber, at stock rosmaster."""
    heard = _Calls()
    server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
    server.register_function(heard, "publisherUpdate")
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    uri = f"http://127.0.0.1:{server.server_address[1]}/"
    with silent_port() as port:
        line = Line(master.port)
        for number in range(dead):
            where = f"http://127.1.0.{number + 1}:{port}/"
            line.ask(request("registerSubscriber", f"/dead{number}", TOPIC, TYPE, where))
        line.ask(request("registerSubscriber", "/live", TOPIC, TYPE, uri))
        taken: list[float] = []
        for number in range(ROUNDS):
            begin, before = time.perf_counter(), len(heard.at)
            method, *rest = _change(number)
            line.ask(request(method, "/talker", TOPIC, *rest, "http://127.0.0.1:9/"))
            taken.append(min(heard.wait(before + 1) - begin, GIVE_UP))
            if taken[-1] == GIVE_UP:
                break
    server.shutdown()
    server.server_close()
    return round(median(taken) * 1000, 2)


def _change(number: int) -> tuple[str, ...]:
    return ("unregisterPublisher",) if number % 2 else ("registerPublisher", TYPE)


async def secure_updates(site: Site, master: Master, dead: int) -> float:
    """The same at ours."""
    told: asyncio.Queue[float] = asyncio.Queue()

    async def dispatch(method: str, params: tuple[object, ...], peer: Identity) -> object:  # noqa: ARG001
        if method == "publisherUpdate":
            told.put_nowait(time.perf_counter())
        return [1, "", 0]

    async def slave(stream: SecureStream[Identity]) -> None:
        await serve_calls(stream, dispatch)

    async def client(name: str) -> tuple[EnrolledNode, RpcClient]:
        member = enroll(site, name, {TOPIC: Right.PUBLISH | Right.SUBSCRIBE})
        stream = await connect(
            "127.0.0.1", master.port, SecureContext(member.credentials, site.anchor.verify), WireProtocol.HTTP
        )
        found = RpcClient(stream)
        await found.ask("rossec.presentGrants", name, [member.grant])
        return member, found

    with silent_port() as port:
        for number in range(dead):
            name, where = f"/dead{number}", f"http://127.1.0.{number + 1}:{port}/"
            _, one = await client(name)
            await one.ask("registerSubscriber", name, TOPIC, TYPE, where)
        live, first = await client("/live")
        server = serve(
            slave, "127.0.0.1", 0, SecureContext(live.credentials, site.anchor.verify), WireProtocol.HTTP
        )
        uri = f"http://127.0.0.1:{server.port}/"
        await first.ask("registerSubscriber", "/live", TOPIC, TYPE, uri)
        _, talker = await client("/talker")
        taken = []
        for number in range(ROUNDS):
            begin = time.perf_counter()
            method, *rest = _change(number)
            await talker.ask(method, "/talker", TOPIC, *rest, "http://127.0.0.1:9/")
            async with asyncio.timeout(GIVE_UP):
                taken.append(await told.get() - begin)
        await server.close()
    return round(median(taken) * 1000, 2)


def percentile(values: list[float], share: float) -> float:
    """The value below which `share` of the sorted `values` lie."""
    return round(values[min(len(values) - 1, int(share * len(values)))], 2)


def node_environ(site: Site, master: Master) -> dict[str, str]:
    """What a node of this site runs in."""
    return {
        "ROSSEC_HOME": str(Path(site.root)),
        "ROS_IP": "127.0.0.1",
        "ROS_MASTER_URI": f"http://127.0.0.1:{master.port}/",
    }
