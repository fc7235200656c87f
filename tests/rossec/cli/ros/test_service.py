"""`rossec service` against a real master and a real provider."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grants.model import Right
from rossec.node import Node, message_type, register_service_type
from tests.support.background import command, serving
from tests.support.site import Site

DIM = "uint8 level\n---\nfloat32[] levels\nstd_msgs/String[] names\nuint8[2] pair\n"


async def provide(node: Node) -> None:
    register_service_type("hall_srvs/Dim", DIM)

    def switch(request: Any) -> dict[str, object]:
        return {"success": request.data, "message": "a\x1b[2J\nb"}

    def dim(request: Any) -> Any:
        name = message_type("std_msgs/String").create(data="bulb")
        return dimmer.create(levels=np.array([request.level / 2], np.float32), names=[name])

    await node.service("/lamp/on", "std_srvs/SetBool", switch)
    await node.service("/lamp/off", "std_srvs/Empty", lambda _: None)
    dimmer = await node.service("/lamp/dim", "hall_srvs/Dim", dim)


def prepare(site: Site) -> None:
    site.grant("/lamp", Right.PROVIDE, "/lamp/*")
    site.grant("/hall", Right.CALL, "/lamp/*")
    site.enroll("/eve")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with serving(tmp_path_factory.mktemp("site"), "/lamp", prepare, provide) as site:
        yield site


def said(site: Site, capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    capsys.readouterr()
    ended = command(site, "service", *words)
    out, err = capsys.readouterr()
    assert ended == code, err
    assert "Traceback" not in err
    return out if code == 0 else err


def test_services_are_listed(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    assert said(site, capsys, "list", "--as", "/hall") == "/lamp/dim\n/lamp/off\n/lamp/on\n"
    listed = json.loads(said(site, capsys, "list", "--as", "/hall", "--json"))
    assert listed["/lamp/on"] == ["/lamp"]
    assert said(site, capsys, "list", "--as", "/eve") == ""


def test_the_provider_of_a_service_is_shown(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    out = said(site, capsys, "info", "/lamp/on", "--as", "/hall")
    assert out.startswith("node: /lamp\nuri: rosrpc://127.0.0.1:")
    assert out.endswith("type: std_srvs/SetBool\nmd5sum: 09fb03525b03e7ea1fd3992bafd87e16\n")
    found = json.loads(said(site, capsys, "info", "/lamp/on", "--as", "/hall", "--json"))
    assert found["type"] == "std_srvs/SetBool"


def test_the_type_of_a_service_is_printed(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    assert said(site, capsys, "type", "/lamp/on", "--as", "/hall") == "std_srvs/SetBool\n"


def test_a_service_is_called(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    out = said(site, capsys, "call", "/lamp/on", "{data: true}", "--as", "/hall")
    assert out == 'success: True\nmessage: "a\\u001b[2J\\nb"\n'
    out = said(site, capsys, "call", "/lamp/on", "--as", "/hall", "--json")
    assert json.loads(out) == {"success": False, "message": "a\x1b[2J\nb"}
    assert said(site, capsys, "call", "/lamp/off", "--as", "/hall") == ""


def test_a_service_type_is_read_from_a_file(
    site: Site, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "Dim.srv"
    file.write_text(DIM)
    call = ("call", "/lamp/dim", "{level: 3}", "--as", "/hall", "--definition", str(file))
    out = said(site, capsys, *call, "--type", "hall_srvs/Dim", "--json")
    assert json.loads(out) == {"levels": [1.5], "names": [{"data": "bulb"}], "pair": [0, 0]}
    assert "hint: give --type" in said(site, capsys, *call, code=1)
    file.write_bytes(b"\xff")
    assert "is not text" in said(site, capsys, *call, "--type", "hall_srvs/Dim", code=1)


@pytest.mark.parametrize(
    ("words", "error", "hint"),
    [
        (("call", "/lamp/on", "--as", "/eve"), "call on /lamp/on", ""),
        (("info", "/lamp/on", "--as", "/eve"), "call on /lamp/on", ""),
        (("call", "/lamp/none", "--as", "/hall"), "no node provides /lamp/none", "start its"),
        (("call", "/lamp/on", "{dat: 1}", "--as", "/hall"), "no field 'dat'", "it has data"),
        (("call", "/lamp/on", "{", "--as", "/hall"), "cannot parse", ""),
        (("call", "/lamp/on", "--type", "a/B", "--as", "/hall"), "unknown service type", "std_srvs"),
        (("list", "--as", "/nobody"), "/nobody has no", "rossec node request"),
    ],
)
def test_a_wrong_call_is_refused(
    site: Site, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], error: str, hint: str
) -> None:
    err = said(site, capsys, *words, code=1)
    assert err.startswith("rossec: ")
    assert error in err
    assert hint in err
