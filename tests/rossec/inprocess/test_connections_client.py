"""A program that calls services: what it sends, which answers it takes, and what may stay plain."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from grants.model import Right
from rossec.channel.opening import REFUSAL
from rossec.participant.access import FIELD
from rossec.ros import tcpros
from tests.support.attacker import HOST, call, credentials
from tests.support.fleet import Program, entitle, environment, program
from tests.support.lamp import BOOL, only, switch
from tests.support.secure_sockets import background
from tests.support.site import Site, coarse

pytestmark = [pytest.mark.ros, pytest.mark.asyncio(loop_scope="module")]
NAME, OPEN, SECRET = "/porter", "/plain/open", "/plain/secret"
OPEN_TOPIC = "/porter/open"

PORTER = """
import rossec
rossec.secure(allow_plain=["/plain/open", "/porter/open", "/porter/none"])
import rospy, rospy.impl.tcpros_base, sys
from std_msgs.msg import String
from std_srvs.srv import SetBool
rospy.init_node("porter")
rospy.Publisher("/porter/open", String, queue_size=1, latch=True).publish("open to all")
rospy.Publisher("/porter/closed", String, queue_size=1, latch=True).publish("secret")
print("PORT", rospy.impl.tcpros_base.get_tcpros_server_address()[1], flush=True)
for line in sys.stdin:
    service, on = line.split()
    try:
        said = "ANSWER " + rospy.ServiceProxy(service, SetBool)(on == "on").message
    except Exception as error:
        said = f"ERROR {error}"
    print(said + "\\n", end="", flush=True)  # at once: rospy writes its log to the same place
"""


class PlainService:
    """A service of a plain node: it answers plain callers only; `headers` is what they sent."""

    def __init__(self) -> None:
        self.headers: list[bytes] = []
        self.server = socket.create_server((HOST, 0))
        self.uri = f"rosrpc://{HOST}:{self.server.getsockname()[1]}"
        self.thread: threading.Thread = background(self.serve)

    def serve(self) -> None:
        with contextlib.suppress(OSError):  # how the shutdown appears
            while True:
                with self.server.accept()[0] as caller, contextlib.suppress(ConnectionError):
                    self.answer(caller)

    def answer(self, caller: socket.socket) -> None:
        caller.settimeout(10)
        length = caller.recv(4, socket.MSG_WAITALL)
        size = int.from_bytes(length, "little")
        if size > tcpros.HEADER_LIMIT:
            caller.sendall(tcpros.error_header("a plain node"))
            return
        if not length:
            return
        self.headers.append(caller.recv(size, socket.MSG_WAITALL))
        caller.sendall(tcpros.encode({"callerid": "/plain", "md5sum": "*", "type": BOOL}))
        caller.recv(5, socket.MSG_WAITALL)
        caller.sendall(b"\1" + tcpros.frame(b"\1" + tcpros.frame(b"in clear")))

    def close(self) -> None:
        self.server.shutdown(socket.SHUT_RDWR)
        self.server.close()
        self.thread.join(30)


@pytest.fixture(scope="module")
def plain() -> Iterator[PlainService]:
    service = PlainService()
    yield service
    service.close()


async def register(site: Site, service: PlainService) -> None:
    """Register the plain services with the master, as a node with the rights would."""
    entitle(site, "/plain", {Right.PROVIDE: ("/plain/*",)})
    assert site.master is not None
    own, uri = credentials(site, "/plain"), site.master.uri
    grants = site.enroll("/plain").grants()
    await call(uri, own, "rossec.presentGrants", "/plain", grants)
    for name in (OPEN, SECRET):
        answer: Any = await call(
            uri, own, "registerService", "/plain", name, service.uri, "http://127.0.0.1:9/"
        )
        assert answer[0] == 1, answer


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def porter(tmp_path_factory: pytest.TempPathFactory, plain: PlainService) -> AsyncIterator[Program]:
    directory: Path = tmp_path_factory.mktemp("porter")
    async with Site(directory / "site").running() as site:
        entitle(site, NAME, {Right.PUBLISH: ("/porter/*",), Right.CALL: ("/plain/*", "/lamp/on")})
        site.grant(NAME, Right.CALL, "/lamp/odd", restriction=coarse())
        site.grant("/lamp", Right.PROVIDE, "/lamp/*", restriction=only("SetBoolRequest", "!msg.data"))
        await register(site, plain)
        env = environment(site, directory)
        async with site.node("/lamp") as lamp, program(env, PORTER, told=True) as running:
            for name in ("/lamp/on", "/lamp/odd", "/lamp/other"):
                await lamp.service(name, BOOL, switch)
            yield running


async def said(porter: Program, service: str, on: str = "off") -> str:
    """What the program gets of a call."""
    await porter.tell(f"{service} {on}")
    while not (line := await porter.read_until(" ")).startswith(("ANSWER", "ERROR")):
        pass
    return line


async def test_a_service_is_called_within_the_grant_of_its_provider(porter: Program) -> None:
    assert await said(porter, "/lamp/on") == "ANSWER on is False"
    assert "does not allow this request" in await said(porter, "/lamp/on", "on")


async def test_a_service_is_not_even_found_without_a_grant(porter: Program) -> None:
    assert "[/lamp/other] unavailable" in await said(porter, "/lamp/other")


async def test_the_refusal_of_a_provider_is_reported(porter: Program) -> None:
    assert "restricted for messages of type" in await said(porter, "/lamp/odd")


async def test_only_a_named_service_is_called_in_plain(porter: Program, plain: PlainService) -> None:
    assert await said(porter, OPEN) == "ANSWER in clear"
    assert FIELD.encode() not in b"".join(plain.headers), "grants are secret"
    plain.headers.clear()
    assert "the peer is a plain ROS node" in await said(porter, SECRET)
    assert SECRET.encode() not in b"".join(plain.headers), "it is only asked what it speaks"


def answer_to_plain(porter: Program, topic: str) -> bytes:
    """What a plain subscriber receives first."""
    port = int(porter.said.partition("PORT ")[2].split()[0])
    fields = {"topic": topic, "md5sum": "*", "type": "*", "callerid": "/x"}
    with socket.create_connection((HOST, port)) as caller:
        caller.settimeout(20)
        caller.sendall(tcpros.encode(fields))
        return caller.recv(1 << 16)


async def test_only_a_named_topic_is_served_in_plain(porter: Program) -> None:
    await said(porter, "/lamp/on")
    for topic, expected in (
        (OPEN_TOPIC, b"message_definition"),
        ("/porter/none", b"no such topic"),
        ("/porter/closed", REFUSAL.encode()),
    ):
        assert expected in await asyncio.to_thread(answer_to_plain, porter, topic)
