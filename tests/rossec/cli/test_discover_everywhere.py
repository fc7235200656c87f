"""`discover:` in every command that talks to a master: each takes the URI from one place.

A new command belongs in one of these tables. What `FINDS` lists is run. What takes `--master` hands
it to the same place, and the source is searched for other ways to a master.
"""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import click
import pytest

from rossec.cli.main import run
from rossec.cli.shared import options as shared_options
from rossec.errors import ConfigurationError
from tests.rossec.cli.walk import commands
from tests.support.commands import Shell
from tests.support.discovered import Searches
from tests.support.site import Site

ROOT: Final = Path(__file__).parents[3]
CLI: Final = ROOT / "rossec" / "cli"
SHARED: Final = CLI / "shared" / "master.py"
AS: Final = ("--as", "/robot")

FINDS: Final = {
    "doctor": ("doctor", "/robot"),
    "graph": ("graph", *AS),
    "node info": ("node", "info", "/x", *AS),
    "node list": ("node", "list", *AS),
    "param delete": ("param", "delete", "/x", *AS),
    "param get": ("param", "get", "/x", *AS),
    "param list": ("param", "list", *AS),
    "param set": ("param", "set", "/x", "1", *AS),
    "policy learn": ("policy", "learn", "--from-graph", "/robot", "--policy", "POLICY"),
    "service call": ("service", "call", "/x", *AS),
    "service info": ("service", "info", "/x", *AS),
    "service list": ("service", "list", *AS),
    "service type": ("service", "type", "/x", *AS),
    "topic bw": ("topic", "bw", "/x", *AS),
    "topic echo": ("topic", "echo", "/x", *AS),
    "topic find": ("topic", "find", "std_msgs/String", *AS),
    "topic hz": ("topic", "hz", "/x", *AS),
    "topic info": ("topic", "info", "/x", *AS),
    "topic list": ("topic", "list", *AS),
    "topic pub": ("topic", "pub", "/x", "std_msgs/String", "data: hi", *AS),
    "topic type": ("topic", "type", "/x", *AS),
    "gateway": ("gateway", "--from", "hospital", "/x"),
    "namespace serve": ("namespace", "serve", *AS),
}
"""Run as a node of this host, with ROS_MASTER_URI=discover:."""

DELIVERS: Final = {
    "ca approve",
    "ca enroll",
    "ca import",
    "ca invitations revoke",
    "ca publish",
    "ca refresh",
    "ca revoke",
    "ca serve",
    "ca sign",
    "ca thing",
    "domain accept",
    "domain limit",
    "domain remove",
    "grant approve",
    "grant decide",
    "grant deliver",
    "grant list",
    "grant revoke",
    "grant sign",
    "master delegate",
    "policy apply",
    "privacy opt-out",
}
"""Take `--master`, which `rossec.cli.shared.master` reads, and call as the authority's node."""

ELSEWHERE: Final = {
    "run": "the sidecar finds the master (tests/rossec/sidecar)",
    "sidecar": "as run",
    "discover": "lists what the others choose from",
    "master": "is the master: own_variables",
    "relay": "with_master, below",
    "border": "with_master, below",
    "console": "its preview finds the master (tests/rossec/console/preview)",
}

_FILES: Final = "reads or writes files of this host"
_RECORD: Final = "asks the authority's record, or its service, on this host"
_SOCKET: Final = "asks a program of this host at its socket"
_PEER: Final = "talks to an authority or a node, at the address in a code"
NONE: Final = {
    "audit": _FILES,
    "border add": _FILES,
    "border credential": _FILES,
    "border forget": _FILES,
    "border install": _FILES,
    "border labels": _FILES,
    "border list": _FILES,
    "border status": _FILES,
    "ca backup": _FILES,
    "ca deny": _RECORD,
    "ca init": _FILES,
    "ca intermediate install": _FILES,
    "ca intermediate request": _FILES,
    "ca intermediate sign": _RECORD,
    "ca invitations": _RECORD,
    "ca invite": _RECORD,
    "ca list": _RECORD,
    "ca lock": _SOCKET,
    "ca log": _RECORD,
    "ca log head": _RECORD,
    "ca log prove": _RECORD,
    "ca log verify": _RECORD,
    "ca renew": _RECORD,
    "ca requests": _RECORD,
    "ca restore": _FILES,
    "ca show": _RECORD,
    "ca status": _SOCKET,
    "ca things": _RECORD,
    "ca unlock": _SOCKET,
    "completion": _FILES,
    "console approvals": _RECORD,
    "console phone": _RECORD,
    "console phones": _RECORD,
    "console phones remove": _RECORD,
    "console tls": _FILES,
    "demo": "starts a master of its own",
    "domain bundle": _RECORD,
    "domain list": _RECORD,
    "domain show": _RECORD,
    "explain": _FILES,
    "federation add": _FILES,
    "federation list": _FILES,
    "federation param": _FILES,
    "federation remove": _FILES,
    "federation status": _SOCKET,
    "gateway status": _SOCKET,
    "grant deny": _RECORD,
    "grant install": _FILES,
    "grant narrow": _FILES,
    "grant pending": _RECORD,
    "grant presets": _FILES,
    "grant request": _FILES,
    "grant show": _FILES,
    "master status": _SOCKET,
    "master stop": _SOCKET,
    "namespace check": _FILES,
    "namespace launch": _FILES,
    "namespace messages": _FILES,
    "namespace name": _FILES,
    "namespace rules": _FILES,
    "node code": _FILES,
    "node confirm": _SOCKET,
    "node enroll": _PEER,
    "node install": _FILES,
    "node join": _PEER,
    "node labels": _FILES,
    "node request": _FILES,
    "node show": _FILES,
    "policy check": _FILES,
    "policy import-sros2": _FILES,
    "policy init": _FILES,
    "policy test": _FILES,
    "policy lint": _FILES,
    "policy review": _FILES,
    "privacy": _FILES,
    "relay add": _FILES,
    "relay descriptor": _FILES,
    "relay list": _FILES,
    "relay remove": _FILES,
    "relay account": _FILES,
    "relay status": _SOCKET,
    "router": "knows no domain",
    "router accounts add": _FILES,
    "router accounts list": _FILES,
    "router accounts remove": _FILES,
    "router accounts show": _FILES,
    "router share": _FILES,
    "router take": _FILES,
    "simulate": _FILES,
}
"""Have no master."""


def test_every_command_finds_its_master_or_has_none() -> None:
    listed = [*FINDS, *DELIVERS, *ELSEWHERE, *NONE]
    assert len(listed) == len(set(listed))
    assert {words for words, _ in commands()} == set(listed)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    site = Site(tmp_path_factory.mktemp("home"))
    for name in ("/robot", "/gateway"):
        site.enroll(name)
    site.publish("/robot", "/x")
    return site.root


@pytest.mark.parametrize("words", FINDS.values(), ids=FINDS)
def test_it_looks_for_the_master(
    words: tuple[str, ...], home: Path, searches: Searches, capsys: pytest.CaptureFixture[str]
) -> None:
    searches.result = ConfigurationError("this search ends here", "as the test has it")
    environ = {"ROSSEC_HOME": str(home), "ROS_IP": "127.0.0.1", "ROS_MASTER_URI": "discover:"}
    policy = str(home / "policy.yaml")
    assert run([policy if word == "POLICY" else word for word in words], environ) == 1
    assert searches.made == ["/gateway" if words[0] == "gateway" else "/robot"]
    assert "this search ends here" in "".join(capsys.readouterr())


@pytest.mark.parametrize("words", [("ca", "publish"), ("ca", "serve", "--locked")])
def test_it_looks_for_the_master_of_the_authority(
    words: tuple[str, ...], shell: Shell, searches: Searches
) -> None:
    searches.result = ConfigurationError("this search ends here", "as the test has it")
    said = shell(*words, "--master", "discover:")
    assert said.code in {1, 3}
    assert "this search ends here" in said.err
    assert searches.made == ["/ca"]


def test_all_take_the_same_option() -> None:
    @click.command()
    @shared_options.master_uri
    def probe() -> None:
        """Has it."""

    wanted = probe.params[0].to_info_dict()
    found = {
        words: parameter.to_info_dict()
        for words, command in commands()
        for parameter in command.params
        if parameter.name == "master_uri"
    }
    assert set(found) == DELIVERS
    assert all(option == wanted for option in found.values())


FORBIDDEN: Final = {"Node": "node_as", "discover_master": "find_master", "master_connection": "master_as"}
CONNECTS_NOT: Final = {
    "rossec/cli/completion/sources.py": "finds the names that were kept for this value",
    "rossec/cli/ros/graph.py": "keeps names for completion by this value",
    "rossec/cli/manual.py": "explains it",
}
READ_IT: Final = {"RelayMember", "BorderRouter"}  # ROS_MASTER_URI, from their argument


def ways_around(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        where = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}"
        match node:
            case ast.Constant(value="ROS_MASTER_URI"):
                if where.partition(":")[0] not in CONNECTS_NOT:
                    yield f"{where}: reads ROS_MASTER_URI"
            case ast.Call(func=ast.Name(id=name)) if name in FORBIDDEN:
                yield f"{where}: {name}, not {FORBIDDEN[name]}"
            case ast.Call(func=ast.Name(id=name)) if name in READ_IT:
                if "with_master(" not in ast.unparse(node):
                    yield f"{where}: {name} without with_master"
            case ast.Call(func=ast.Attribute(value=ast.Name(id="settings"), attr="read")):
                if "own_variables(" not in ast.unparse(node):
                    yield f"{where}: settings.read without own_variables"
            case _:
                pass


def test_there_is_no_other_way_to_a_master() -> None:
    sources = [path for path in sorted(CLI.rglob("*.py")) if path != SHARED]
    assert [found for path in sources for found in ways_around(path)] == []
    assert len(list(ways_around(SHARED))) > 1, "the search finds what it looks for"
