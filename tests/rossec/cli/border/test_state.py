"""`rossec border list | status | forget`."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from ca.things import ThingKey, ThingSecret, ThingStatement, sign_statement
from rossec import clock
from rossec.border import border_router
from rossec.home import NodeHome
from rossec.saved_statements import ThingFiles
from tests.support.commands import Shell, refused
from tests.support.pki import new_signer
from tests.support.site import Site

LAMP = "/things/lamp"


@pytest.fixture
def router(empty: Shell) -> Shell:
    site = Site(empty.root)
    home = site.enroll("/border")
    files, now = ThingFiles(home), site.now()
    lamp = ThingStatement(
        "home",
        LAMP,
        ThingKey.of(new_signer().public_key, b"\x2b"),
        home.identity(now).thumbprint,
        now - 60,
        now + 600,
        bytes(16),
    )
    fan = replace(
        lamp,
        name="/things/fan",
        not_before=0,
        expires=now - 1,
        credential=ThingSecret.of(files.create_secret("/things/fan"), b"\x07"),
    )
    for each in (lamp, fan):
        files.install(sign_statement(site.authority.signer, each))
    return empty


def test_the_things_are_listed(router: Shell) -> None:
    lines = router("border", "list").out.splitlines()
    assert lines[0] == "/things/fan  secret 07  expired"
    assert lines[1].startswith("/things/lamp  key 2b  until ")
    found = json.loads(router("border", "list", "--json").out)["things"]
    assert [(each["name"], each["kind"], each["kid"]) for each in found] == [
        ("/things/fan", "psk", "07"),
        (LAMP, "edhoc", "2b"),
    ]


def test_a_file_that_is_no_statement_is_named(router: Shell) -> None:
    (router.node("/border") / "things" / "tap.cose").write_bytes(b"tap")
    said = router("border", "list")
    assert "rossec: error: tap.cose: not a statement" in said.err
    assert len(said.out.splitlines()) == 2


def test_a_thing_is_forgotten(router: Shell) -> None:
    said = router("border", "forget", "/things/fan")
    assert said.out == "/things/fan is not served here any more\n"
    assert "rossec ca revoke --thing /things/fan" in said.err
    assert ThingFiles(NodeHome.of(router.root, "/border")).load().statements.keys() == {LAMP}
    refused(router("border", "forget", "/things/fan"), "nothing about /things/fan", "border list")
    router("border", "forget", LAMP)
    assert "there are no things here" in router("border", "list").err


def test_what_a_running_router_does(router: Shell) -> None:
    refused(router("border", "status"), "no border router runs here", "rossec border")
    there = {"there": True, "offered": 1, "resources": 2, "received": 9, "refused": 1, "over_rate": 3}
    border_router.write_status(
        router.node("/border"),
        {
            "at": clock.now(),
            "address": ["::", 5683],
            "counts": {"datagrams": 20, "refused": 2, "over_budget": 0, "handshakes": 1, "derivations": 2},
            "things": {
                LAMP: there,
                "/a": {**there, "there": False},
                "/b": {"there": True},
                "/c": {"there": False},
            },
        },
    )
    lines = router("border", "status").out.splitlines()
    assert lines == [
        "at :: port 5683: 3 times a thing came, 2 of 20 datagrams refused",
        "/a  not there, offers 1 of 2, 9 messages, 4 dropped",
        "/b  is there, starting",
        "/c  not there",
        "/things/lamp  there, offers 1 of 2, 9 messages, 4 dropped",
    ]
    assert json.loads(router("border", "status", "--json").out)["things"][LAMP] == there


def test_it_needs_an_identity_and_for_some_the_extra(
    empty: Shell, router: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused(router("border", "list", "--as", "/attic"), "/attic has no ca.pem")
    monkeypatch.setitem(sys.modules, "rossec.border.border_router", None)
    monkeypatch.delattr("rossec.border.border_router", raising=False)
    refused(router("border", "status"), "not installed", "rossec[constrained]")


def test_no_secret_is_shown(router: Shell) -> None:
    secret = Path(router.node("/border") / "things" / "things.fan.key").read_bytes()
    for command in (("list",), ("list", "--json"), ("forget", "/things/fan")):
        said = router("border", *command)
        assert secret.hex() not in said.out + said.err
