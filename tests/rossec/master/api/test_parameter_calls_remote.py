"""Parameters of other masters are read as own ones, and set by nobody here."""

from typing import Any

import pytest

from grants.decision import Reach
from grants.model import Permission, Right
from rossec.master.api.methods import ParameterChanged
from rossec.master.rights.caller import Caller
from rossec.master.state.imported_facts import Site
from rossec.master.state.imports import Imports
from rossec.master.state.registry import NodeRef, Registry
from tests.rossec.master.fakes import FakeStatements, call_api, master_api, refuse

KITCHEN, SPEED = Site("kitchen"), "/remote/kitchen/robot/speed"
READER = NodeRef("/reader", "http://r:1/", b"/reader")


def reader(*patterns: str) -> Caller:
    rights = Right.PARAM_GET | Right.PARAM_SET
    reach = Reach(Permission(pattern, rights) for pattern in patterns)
    domains = {"kitchen": ""}
    return Caller(READER.name, READER.thumbprint, reach, refuse, domain_of=domains.get)


class Mirroring:
    def __init__(self) -> None:
        registry = Registry()
        self.imports = Imports(registry)
        self.statements = FakeStatements({"/reader": reader("/robot/**")})
        self.api = master_api(
            registry, self.statements, name="/master", uri="http://m:1/", pid=1, imports=self.imports
        )
        self.imports.mirrors.replace(KITCHEN, {"robot": {"speed": 1.5}, "secret": {"key": 7}})

    def ask(self, who: Caller, method: str, *params: object) -> Any:
        return call_api(self.api, method, (who.name, *params), who, 0).answer


@pytest.fixture
def master() -> Mirroring:
    return Mirroring()


def test_a_mirrored_parameter_is_read_with_the_right_on_the_origins_name(master: Mirroring) -> None:
    who = reader("/robot/**")
    assert master.ask(who, "getParam", SPEED)[2] == 1.5
    assert master.ask(who, "getParam", "/remote/kitchen/robot")[2] == {"speed": 1.5}
    assert master.ask(who, "hasParam", SPEED)[2] is True
    assert master.ask(who, "hasParam", "/remote/kitchen/robot/x")[2] is False
    assert master.ask(who, "getParam", "/remote/kitchen/robot/x")[0] == -1
    assert master.ask(who, "searchParam", SPEED)[2] == SPEED
    assert master.ask(who, "getParamNames")[2] == [SPEED]
    for key in ("/remote/kitchen/secret/key", "/remote/kitchen", "/remote"):
        assert master.ask(who, "getParam", key)[0] == -1


def test_the_own_tree_has_no_mirror_in_it(master: Mirroring) -> None:
    who = reader("/**")
    master.ask(who, "setParam", "/own", 1)
    assert master.ask(who, "getParam", "/")[2] == {"own": 1}
    assert sorted(master.ask(who, "getParamNames")[2]) == ["/own", SPEED, "/remote/kitchen/secret/key"]


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("setParam", (SPEED, 2)),
        ("setParam", ("/remote/other", 2)),
        ("deleteParam", (SPEED,)),
        ("setParam", ("/", {"remote": {"kitchen": 1}})),
        ("deleteParam", ("/remote",)),
    ],
)
def test_nothing_is_set_below_remote(master: Mirroring, method: str, params: tuple[object, ...]) -> None:
    code, status, _ = master.ask(reader("/**"), method, *params)
    assert code == -1
    assert "only read here (set it at its own master)" in status
    assert master.ask(reader("/**"), "getParam", SPEED)[2] == 1.5


def test_subscribers_are_sent_what_changes_at_the_origin(master: Mirroring) -> None:
    who = reader("/robot/**")
    assert master.ask(who, "subscribeParam", READER.uri, "/remote/kitchen/robot")[2] == {"speed": 1.5}
    tree: dict[str, object] = {"robot": {"speed": 2.0}, "secret": {"key": 8}}
    changes = master.imports.mirrors.replace(KITCHEN, tree)
    events = master.api.parameters.mirror(changes, 0)
    assert events == (ParameterChanged(READER, f"{SPEED}/", 2.0),)
    del master.statements.callers["/reader"]  # its key is revoked
    changes = master.imports.mirrors.replace(KITCHEN, {})
    assert master.api.parameters.mirror(changes, 0) == ()
