"""Nothing is open by default or by mistake: attacks F11, F12 and F13."""

import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pytest

from rossec.master.api.statement_calls import WATCH_GRANTS
from rossec.master.operation.config import Config, parse
from rossec.ros.names import MASTER
from tests.support.attacker import EVE
from tests.support.caller import caller
from tests.support.commands import Shell, refused
from tests.support.ports import free_port
from tests.support.site import Site
from tests.support.witness import POSE, TOPIC, Witness

NOTHING: Final[tuple[object, ...]] = ("", 0, [], [[], [], []], b"", [b""], {}, {"grants": [], "more": False})


@pytest.mark.attack("open-by-mistake")
def test_f11_an_empty_configuration_opens_nothing() -> None:
    assert parse("", "m.yaml") == Config()
    closed = Config()
    assert (closed.admin, closed.announce, closed.metrics, closed.audit) == (False, False, None, True)


@pytest.mark.attack("open-by-mistake")
async def test_f11_a_node_without_grants_has_no_rights(site: Site, witness: Witness) -> None:
    """Every method, with arguments that would do something: no effect, and nothing is disclosed."""
    assert site.master is not None
    assert site.master._answers is not None
    arguments: dict[str, tuple[Any, ...]] = {
        "lookupService": ("/s",),
        "lookupNode": ("/robot",),
        "getPublishedTopics": ("",),
        "shutdown": ("x",),
        "getParam": ("/",),
        "hasParam": ("/p",),
        "setParam": ("/p", 1),
        "deleteParam": ("/p",),
        "searchParam": ("p",),
        "subscribeParam": ("http://h:1/", "/p"),
        "unsubscribeParam": ("http://h:1/", "/p"),
        "registerService": ("/s", "rosrpc://h:1", "http://h:1/"),
        "unregisterService": ("/s", "rosrpc://h:1"),
        "rossec.watchGraph": ("", 0),
        "rossec.presentGrants": ([],),
        "rossec.renewGrants": ([b"x"],),
        "rossec.renewIdentity": (b"x",),
        "rossec.updateDelegation": (b"x",),
        "rossec.watchRenewals": (0,),
        "rossec.settleRenewals": ([[bytes(32), b"x", ""]],),
        "rossec.revocationsSince": (b"x",),
        "rossec.updateRevocations": (b"x",),
        "rossec.updateRevocationTree": (b"x", b"x"),
        "rossec.revocationProofs": ([],),
        "rossec.trl": (b"\xa0",),
        "rossec.depositGrants": ([b"x"],),
        "rossec.deliveryStates": ([],),
        "rossec.fetchGrants": (b"",),
        "rossec.domains": (b"x",),
        "rossec.updateDomains": (b"x",),
        "rossec.foreignRevocations": ("other", b"x"),
        "rossec.foreignRevocationProofs": ("other", []),
        "rossec.followSite": ("", 0, []),
        "rossec.relayForwardedPorts": ("x", 0, [], {}),
        "rossec.relayTarget": ("", "master", "/master"),
        **{f"register{kind}": (TOPIC, POSE, "http://h:1/") for kind in ("Publisher", "Subscriber")},
        **{f"unregister{kind}": (TOPIC, "http://h:1/") for kind in ("Publisher", "Subscriber")},
    }
    before = site.master.state.registry.version
    told = {
        "getUri",
        "getPid",
        "rossec.revocations",
        "rossec.revocationsSince",
        "rossec.trl",
        "unsubscribeParam",
    }
    async with caller(site, EVE) as eve:
        for method in set(site.master._answers._api.methods) - {WATCH_GRANTS}:  # which waits
            code, status, value = await eve(method, *arguments.get(method, ()))
            assert status.find("arity") < 0, method
            nothing = value in NOTHING or value is False
            assert method in told or code == -1 or nothing, (method, value)
    assert site.master.state.registry.version == before
    assert not site.master.effects.stopping.is_set()


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    """A home with a master that could start, except that its port is in use."""
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
    "another's certificate": lambda path: (path.with_name("eve") / "node.pem").replace(path / "node.pem"),
    "no authority": lambda path: (path / "ca.pem").unlink(),
    "a damaged authority": _write("ca.pem", b"garbage"),
    "damaged revocations": _write("revocations.cose", b"garbage"),
    "empty revocations": _write("revocations.cose", b""),
}


@pytest.mark.attack("open-by-mistake")
@pytest.mark.parametrize("flaw", BROKEN)
def test_f12_a_master_with_damaged_files_does_not_start(shell: Shell, taken: int, flaw: str) -> None:
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
def test_f13_a_misspelt_variable_is_refused(shell: Shell, taken: int, variable: str, value: str) -> None:
    shell.environ[variable] = value
    said = shell("master", "--port", str(taken))
    assert said.code == 1
    assert variable in said.err
    assert "already in use" not in said.err, "it would have started"


@pytest.mark.attack("open-by-mistake")
@pytest.mark.parametrize(
    "text", ["audit: ture", "admin: on", "limits: {idle_second: 5}", "limits: {body: -1}", "log: JSON"]
)
def test_f13_a_misspelt_setting_is_refused(shell: Shell, text: str) -> None:
    config = shell.root / "master.yaml"
    config.write_text(text)
    said = shell("master", "--config", str(config), "--port", str(free_port()))
    assert (said.code, f"{config}:1: " in said.err) == (1, True)
