"""`rossec param` against a real master."""

import json
from collections.abc import Iterator

import pytest

from grants.model import Right
from rossec.node import Node
from tests.support.background import command, serving
from tests.support.site import Site


async def nothing(_: Node) -> None:
    """The master is enough."""


def prepare(site: Site) -> None:
    site.grant("/robot", Right.PARAM_GET | Right.PARAM_SET, "/robot")
    site.enroll("/eve")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with serving(tmp_path_factory.mktemp("site"), "/robot", prepare, nothing) as site:
        yield site


def said(
    site: Site, capsys: pytest.CaptureFixture[str], *words: str, node: str = "/robot", code: int = 0
) -> str:
    capsys.readouterr()
    ended = command(site, "param", *words, "--as", node)
    out, err = capsys.readouterr()
    assert ended == code, err
    assert "Traceback" not in err
    return out if code == 0 else err


@pytest.mark.parametrize(
    ("value", "shown", "as_json"),
    [
        ("true", "true", True),
        ("7", "7", 7),
        ("0.5", "0.5", 0.5),
        ('"a\\u202eb"', "a\\u202eb", "a\u202eb"),
        ("[1, 'a\n']", '[1, "a "]', [1, "a "]),
        ("{b: {c: 1}}", '{\n  "b": {\n    "c": 1\n  }\n}', {"b": {"c": 1}}),
        ("!!binary aGk=", '"aGk="', "aGk="),
        ("2026-01-02 03:04:05", '"2026-01-02 03:04:05"', "2026-01-02 03:04:05"),
    ],
)
def test_a_parameter_is_set_and_read(
    site: Site, capsys: pytest.CaptureFixture[str], value: str, shown: str, as_json: object
) -> None:
    assert said(site, capsys, "set", "/robot/value", value) == ""
    assert said(site, capsys, "get", "/robot/value") == f"{shown}\n"
    assert json.loads(said(site, capsys, "get", "~value", "--json")) == as_json


def test_parameters_are_listed_and_deleted(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    said(site, capsys, "set", "/robot", "{a: {b: 1}, ab: 2}")
    assert said(site, capsys, "list") == "/robot/a/b\n/robot/ab\n"
    assert said(site, capsys, "list", "/robot/a") == "/robot/a/b\n"
    assert json.loads(said(site, capsys, "list", "/robot/ab", "--json")) == ["/robot/ab"]
    assert said(site, capsys, "list", node="/eve") == ""
    said(site, capsys, "delete", "/robot/a")
    assert said(site, capsys, "list") == "/robot/ab\n"


@pytest.mark.parametrize(
    ("words", "node", "error", "hint"),
    [
        (("get", "/robot/none"), "/robot", "/robot/none is not set", "rossec param list"),
        (("delete", "/robot/none"), "/robot", "/robot/none is not set", "rossec param list"),
        (("get", "/robot/value"), "/eve", "param-get on /robot/value", ""),
        (("set", "/robot/value", "1"), "/eve", "param-set on /robot/value", ""),
        (("set", "/robot/value", ""), "/robot", "cannot be null", "rossec param delete"),
        (("set", "/robot/value", '"\\e[2J"'), "/robot", "XML-RPC cannot carry", "as bytes"),
        (("set", "/robot/value", "[1"), "/robot", "cannot parse", ""),
        (("set", "/robot/value", "99999999999"), "/robot", "XML-RPC cannot carry", ""),
        (("list",), "/nobody", "/nobody has no", "rossec node request"),
    ],
)
def test_a_wrong_call_is_refused(
    site: Site, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], node: str, error: str, hint: str
) -> None:
    err = said(site, capsys, *words, node=node, code=1)
    assert error in err
    assert hint in err


@pytest.mark.parametrize("name", ["hospital:/speed", "/remote/hospital/speed"])
def test_parameters_of_other_masters_are_not_written(
    site: Site, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    for words, done in ((("set", name, "1"), "set"), (("delete", name), "deleted")):
        reason = said(site, capsys, *words, code=1)
        assert f"/remote/hospital/speed cannot be {done} here" in reason
        assert "hint: take a name outside /remote" in reason
    assert "is not a label" in said(site, capsys, "get", "a b:/speed", code=1)
