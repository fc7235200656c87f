"""What others learnt the hard way, tried here: attacks D1, D2, D6, F1, F8, F9, F11 to F13.

Against a running master; what ordinary nodes do in these cases is in the files beside this one.
"""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, Final

import pytest

from grants.model import Right
from grants.reach import Reach
from rossec.errors import ChannelError, PeerRefused, RossecError
from rossec.master.operation.config import Config, parse
from rossec.master.rights.statements import TrustState
from rossec.net.aio import WireProtocol, connect
from rossec.net.rpc.client import RpcClient
from rossec.participant.slave_api import MASTER
from rossec.ros import xmlrpc
from tests.support.attacker import EVE, HOST, call, credentials, dial, fields_for, knock, signed
from tests.support.caller import caller
from tests.support.commands import Shell, refused
from tests.support.masterprocess import free_port
from tests.support.site import Site
from tests.support.witness import FRAME, POSE, TOPIC, Witness, until

T = "std_msgs/String"
EVERYTHING: Final = {"/**": Right(255)}


class Tap:
    """A wire that somebody listens to: every byte of both directions."""

    def __init__(self, port: int) -> None:
        self._to = port
        self.heard = bytearray()

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                self.heard += data
                writer.write(data)
                await writer.drain()
        writer.close()

    async def handle(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection(HOST, self._to)
        await asyncio.gather(self._pass_on(reader, far_writer), self._pass_on(far_reader, writer))


@contextlib.asynccontextmanager
async def tapped(port: int) -> AsyncIterator[tuple[Tap, int]]:
    """A port that leads to `port`, past somebody who listens."""
    tap = Tap(port)
    async with await asyncio.start_server(tap.handle, HOST, 0) as server:
        yield tap, server.sockets[0].getsockname()[1]


def holds_none(tap: Tap, *secrets: bytes) -> None:
    assert len(tap.heard) > 500, "nothing was heard at all"
    assert [secret for secret in secrets if secret in tap.heard] == []


# --- D1, D2, D6: what has ended stays ended


@pytest.mark.attack("old-permission")
async def test_d1_an_older_and_wider_grant_cannot_be_put_back(site: Site) -> None:
    """It was revoked when a narrower one took its place; its file is still there."""
    wide = site.grant(EVE, Right.PUBLISH, "/**")
    narrow = site.grant(EVE, Right.PUBLISH, "/eve/t")
    async with caller(site, "/other") as other:
        await other("rossec.updateRevocations", site.revoke(wide))
    await site.restart_master()
    async with caller(site, EVE) as eve:
        await eve("rossec.presentGrants", [wide, narrow])
        assert "revoked" in await eve.refused("registerPublisher", "/robot/t", T, eve.uri)
        assert (await eve("registerPublisher", "/eve/t", T, eve.uri))[0] == 1


@pytest.mark.attack("old-permission")
async def test_d1_an_older_delegation_cannot_be_put_back(site: Site) -> None:
    """The one that was withdrawn renews nothing, whoever brings it again."""
    assert site.master is not None
    older = site.delegate()
    await site.restart_master()
    async with caller(site, EVE, {"/t": Right.PUBLISH}) as eve:
        site.authority.withdraw("test", site.now())
        newest = site.authority.store.newest_list()
        assert (await eve("rossec.updateRevocations", newest))[2] == 1
        assert (await eve("rossec.updateDelegation", older))[2] == 0
        short = site.grant(EVE, Right.PUBLISH, "/t", lifetime=60, cap=9999)
        [renewed] = (await eve("rossec.renewGrants", [short]))[2]
        assert renewed == b""


@pytest.mark.attack("outlived-right")
async def test_d2_a_node_that_never_restarts_loses_its_right_at_once(
    site: Site, witness: Witness
) -> None:
    """Its connections stay open meanwhile, and nobody asks it to do anything."""
    async with caller(site, EVE, {"/t": Right.SUBSCRIBE, "/p": Right.PARAM_GET}) as eve:
        await eve("registerSubscriber", "/t", T, eve.uri)
        await eve("subscribeParam", eve.uri, "/p")
        async with caller(site, "/other", {"/t": Right.PUBLISH, "/p": Right.PARAM_SET}) as other:
            for grant in site.enroll(EVE).grants():
                await other("rossec.updateRevocations", site.revoke(grant))
            eve.told.clear()
            await other("registerPublisher", "/t", T, other.uri)
            await other("setParam", "/p", 1)
            assert (await other("getPid"))[0] == 1
            assert [told for told in eve.told if told[0] != "rossec.revocationUpdate"] == []
            assert "revoked" in await eve.refused("registerSubscriber", "/t", T, eve.uri)
            assert (await eve("getSystemState"))[2] == [[], [], []]


@pytest.mark.attack("outlived-right")
async def test_d6_an_identity_that_ends_takes_its_connection_along(site: Site) -> None:
    assert site.master is not None
    short = site.enroll("/short", 4)
    client = RpcClient(await dial(site.master.uri, short.credentials()))
    assert await client.ask("getPid", "/short")
    async with asyncio.timeout(30):
        await client._stream.wait_ended()  # type: ignore[attr-defined]
    await asyncio.sleep(1.1)  # the last second may be rounded in its favour
    with pytest.raises(RossecError):
        await call(site.master.uri, short.credentials(), "getPid", "/short")


# --- F1, F9: what goes wrong in a guard is a no


def _crash(*_: object, **__: object) -> Any:
    raise RuntimeError("a fault in the guard")


GUARDS: Final[list[tuple[type, str]]] = [
    (TrustState, "caller"),
    (TrustState, "_confirm"),
    (Reach, "covers"),
]


@pytest.mark.attack("crashed-check")
@pytest.mark.parametrize(("where", "name"), GUARDS, ids=[name for _, name in GUARDS])
async def test_f1_a_guard_that_crashes_lets_nobody_through(
    site: Site, monkeypatch: pytest.MonkeyPatch, where: type, name: str
) -> None:
    assert site.master is not None
    async with caller(site, EVE, EVERYTHING) as eve:
        with monkeypatch.context() as patch:
            patch.setattr(where, name, _crash)
            for method, *params in (
                ("registerPublisher", "/t", T, eve.uri),
                ("setParam", "/p", 1),
                ("shutdown", "now"),
            ):
                with contextlib.suppress(RossecError, xmlrpc.Fault):
                    assert (await eve(method, *params))[0] == -1
        assert not list(site.master._registry.nodes())
        assert not site.master._effects.stopping.is_set()
    async with caller(site, EVE) as eve:
        assert (await eve("hasParam", "/p"))[2] is False


@pytest.mark.attack("crashed-check")
async def test_f1_a_crash_while_an_identity_is_checked_ends_the_connection(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert site.master is not None
    assert site.master._server is not None
    server, own = site.master._server, credentials(site)
    loop, seen = asyncio.get_running_loop(), list[Any]()
    loop.set_exception_handler(lambda _, context: seen.append(context))
    with monkeypatch.context() as patch:
        patch.setattr("ca.certificates._check_time", _crash)
        async with asyncio.timeout(3):  # and not only when the handshake has taken too long
            with pytest.raises(ChannelError):
                await call(site.master.uri, own, "getPid", EVE)
    await until(lambda: server.connections == 0, within=3)
    assert "a fault in the guard" in str(seen[0]["exception"])
    async with caller(site, EVE) as eve:
        assert (await eve("getPid"))[0] == 1


CALL = xmlrpc.dump_call("registerPublisher", (EVE, "/t", T, "http://127.0.0.1:9/"))
POST = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n" % len(CALL) + CALL
OPENING = (
    b"GET /rossec HTTP/1.1\r\nHost: rossec\r\nConnection: Upgrade\r\nUpgrade: rossec/1\r\n\r\n"
)


@pytest.mark.attack("plain-peer")
@pytest.mark.parametrize(
    "data",
    [
        POST,
        b"x" + POST,
        b"\r\n" + POST,
        OPENING + POST,
        OPENING + b"\x00" * 40 + POST,
        OPENING + b"\xff" * 5000 + POST,
        OPENING[:-2] + POST,
        OPENING.replace(b"rossec/1", b"websocket") + POST,
        OPENING.replace(b"GET", b"POST") + POST,
        POST + OPENING,
        b"\x14\x00\x00\x00\x10\x00\x00\x00callerid=/viewer" + POST,
    ],
)
async def test_f9_nothing_that_comes_before_the_handshake_is_ever_a_call(
    site: Site, data: bytes
) -> None:
    """One parser for it, and what does not parse there is not handed to another."""
    assert site.master is not None
    loop = asyncio.get_running_loop()
    with socket.socket() as sock:
        sock.setblocking(False)
        await loop.sock_connect(sock, (HOST, site.master.port))
        await loop.sock_sendall(sock, data)
        sock.shutdown(socket.SHUT_WR)
        with contextlib.suppress(ConnectionError):
            async with asyncio.timeout(20):
                while await loop.sock_recv(sock, 4096):
                    pass
    assert site.master.status()["calls"] == 0
    assert not list(site.master._registry.nodes())


# --- F8 (and D3): who listens, or asks without a name, learns nothing


@pytest.mark.attack("read-network")
async def test_f8_a_listener_hears_neither_names_nor_grants(site: Site, witness: Witness) -> None:
    assert site.master is not None
    grant = signed(site)
    async with tapped(site.master.port) as (tap, port):
        client = RpcClient(await dial(f"http://{HOST}:{port}/", credentials(site)))
        assert await client.ask("rossec.presentGrants", EVE, [grant]) == 1
        assert await client.ask("registerSubscriber", EVE, TOPIC, POSE, "http://127.0.0.1:9/")
        await client.close()
        holds_none(tap, TOPIC.encode(), POSE.encode(), b"/eve", b"Grants", grant[-64:], grant[:64])
    async with tapped(witness.topic_port) as (tap, port):
        heard = await knock(port, credentials(site), fields_for(EVE, TOPIC, [grant]), 2000)
        assert FRAME.encode() in heard.after
        holds_none(tap, TOPIC.encode(), FRAME.encode(), b"PoseStamped", b"/eve", grant[-64:])


@pytest.mark.attack("foreign-authority")
async def test_f8_who_has_no_identity_here_hears_nothing_but_a_refusal(
    site: Site, witness: Witness
) -> None:
    """A stranger may go through the whole handshake with certificates of its own."""
    assert site.master is not None
    stranger = credentials(Site(site.root.parent / "other", site.anchor.domain), "/viewer")
    shown: list[tuple[bytes, ...]] = []

    def look(chain: tuple[bytes, ...], now: int) -> Any:
        shown.append(chain)
        return site.anchor.verify(chain, now)

    async def heard(port: int, opening: WireProtocol) -> bytes:
        stream = await connect(HOST, port, stranger, look, opening=opening)
        return await stream.receive()

    for port, opening in (
        (site.master.port, WireProtocol.HTTP), (witness.topic_port, WireProtocol.TCPROS),
    ):  # fmt: skip
        async with tapped(port) as (tap, near):
            with pytest.raises(PeerRefused) as caught:
                await heard(near, opening)
            secrets = TOPIC, POSE, FRAME, "/viewer"
            holds_none(tap, *[secret.encode() for secret in secrets])
            assert not [secret for secret in secrets if secret in str(caught.value)]
    own = b"".join(b"".join(chain) for chain in shown)  # all it could decrypt
    assert TOPIC.encode() not in own
    assert b"spiffe://home/viewer" not in own


# --- F11: what nobody configured is closed


@pytest.mark.attack("open-by-mistake")
def test_f11_an_empty_configuration_opens_nothing() -> None:
    assert parse("", "m.yaml") == Config()
    closed = Config()
    assert (closed.admin, closed.announce, closed.metrics, closed.audit) == (
        False, False, None, True,
    )  # fmt: skip


@pytest.mark.attack("open-by-mistake")
async def test_f11_a_node_that_was_given_nothing_may_nothing(site: Site, witness: Witness) -> None:
    """Every method, with arguments that would do something: no effect, and nothing shown."""
    assert site.master is not None
    assert site.master._answers is not None
    arguments: dict[str, tuple[Any, ...]] = {
        "lookupService": ("/s",), "lookupNode": ("/robot",), "getPublishedTopics": ("",),
        "shutdown": ("x",), "getParam": ("/",), "hasParam": ("/p",), "setParam": ("/p", 1),
        "deleteParam": ("/p",), "searchParam": ("p",), "subscribeParam": ("http://h:1/", "/p"),
        "unsubscribeParam": ("http://h:1/", "/p"), "registerService": ("/s", "rosrpc://h:1", "http://h:1/"),
        "unregisterService": ("/s", "rosrpc://h:1"), "rossec.watchGraph": ("", 0),
        "rossec.presentGrants": ([],), "rossec.renewGrants": ([b"x"],),
        "rossec.renewIdentity": (b"x",), "rossec.updateDelegation": (b"x",),
        "rossec.revocationsSince": (b"x",), "rossec.updateRevocations": (b"x",),
        "rossec.updateRevocationTree": (b"x", b"x"), "rossec.revocationProofs": ([],),
        "rossec.trl": (b"\xa0",),
        **{f"register{kind}": (TOPIC, POSE, "http://h:1/") for kind in ("Publisher", "Subscriber")},
        **{f"unregister{kind}": (TOPIC, "http://h:1/") for kind in ("Publisher", "Subscriber")},
    }  # fmt: skip
    before = site.master._registry.version
    told = {
        "getUri", "getPid", "rossec.revocations", "rossec.revocationsSince", "rossec.trl",
        "unsubscribeParam",
    }  # fmt: skip
    async with caller(site, EVE) as eve:
        for method in site.master._answers._api.methods:
            code, status, value = await eve(method, *arguments.get(method, ()))
            assert status.find("arity") < 0, method
            nothing = value in ("", 0, [], [[], [], []], b"", [b""], {}) or value is False
            assert method in told or code == -1 or nothing, (method, value)
    assert site.master._registry.version == before
    assert not site.master._effects.stopping.is_set()


# --- F12, F13: what cannot be read, or is misspelt, is no reason to go on without


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    """A home with a master that could start, were its port not taken: then that is the refusal."""
    shell = Shell(tmp_path / "home", capsys)
    site = Site(tmp_path / "site")
    for name in (MASTER, EVE):
        site.enroll(name)
    (site.root / "nodes").rename(shell.root / "nodes")
    return shell


@pytest.fixture
def taken() -> Any:
    with socket.create_server(("127.0.0.1", 0)) as sock:
        yield sock.getsockname()[1]


def _write(name: str, data: bytes) -> Callable[[Path], None]:
    return lambda path: void((path / name).write_bytes(data))


def void(_: object) -> None:
    pass


BROKEN: Final[dict[str, Callable[[Path], Any]]] = {
    "no key": lambda path: (path / "node.key").unlink(),
    "a key others read": lambda path: (path / "node.key").chmod(0o644),
    "another key": lambda path: (path.with_name("eve") / "node.key").replace(path / "node.key"),
    "a damaged key": _write("node.key", b"-----BEGIN PRIVATE KEY-----\n"),
    "no certificate": lambda path: (path / "node.pem").unlink(),
    "a damaged certificate": _write("node.pem", b"garbage"),
    "another's certificate": lambda path: (path.with_name("eve") / "node.pem").replace(
        path / "node.pem"
    ),
    "no authority": lambda path: (path / "ca.pem").unlink(),
    "a damaged authority": _write("ca.pem", b"garbage"),
    "damaged revocations": _write("revocations.cose", b"garbage"),
    "empty revocations": _write("revocations.cose", b""),
}


@pytest.mark.attack("open-by-mistake")
@pytest.mark.parametrize("flaw", BROKEN)
def test_f12_a_master_that_cannot_know_does_not_start(shell: Shell, taken: int, flaw: str) -> None:
    refused(shell("master", "--port", str(taken)), "address already in use", "already?")
    BROKEN[flaw](shell.node(MASTER))
    said = shell("master", "--port", str(taken))
    assert said.code == 1
    assert said.err.startswith("rossec: error: ")
    assert "already in use" not in said.err, "it would have started"


@pytest.mark.attack("open-by-mistake")
@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("ROSSEC_POST_QUANTUM", "requier"),
        ("ROSSEC_POST_QUANTUM", ""),
        ("ROS_IPV6", "yes"),
        ("ROSSEC_HOME", "relative/home"),
        ("ROS_MASTER_URI", "https://localhost:11311"),
    ],
)
def test_f13_a_misspelt_mode_is_no_mode(
    shell: Shell, taken: int, variable: str, value: str
) -> None:
    shell.environ[variable] = value
    said = shell("master", "--port", str(taken))
    assert said.code == 1
    assert variable in said.err
    assert "already in use" not in said.err, "it would have started"


@pytest.mark.attack("open-by-mistake")
@pytest.mark.parametrize(
    "text",
    ["audit: ture", "admin: on", "limits: {idle_second: 5}", "limits: {body: -1}", "log: JSON"],
)
def test_f13_a_misspelt_setting_is_no_setting(shell: Shell, text: str) -> None:
    config = shell.root / "master.yaml"
    config.write_text(text)
    said = shell("master", "--config", str(config), "--port", str(free_port()))
    assert (said.code, f"{config}:1: " in said.err) == (1, True)
