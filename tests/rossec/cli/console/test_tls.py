import json
import socket

import pytest

from rossec.console.tls import certificates
from rossec.console.tls.certificates import KEY, open_authority
from tests.support.commands import Shell, refused


def test_there_is_none_at_first(shell: Shell) -> None:
    refused(shell("console", "tls"), "has no TLS authority", "--renew")


def test_it_is_made_shown_and_made_anew(shell: Shell) -> None:
    first = shell("console", "tls", "--renew", "--name", "Rossec.local")
    assert first.code == 0, first
    directory = shell.root / "ca" / "console"
    authority = open_authority(directory)
    assert authority.name == "rossec.local"
    assert certificates.in_words(authority.data) in first.out
    assert "--hand-out" in first.out
    assert shell("console", "tls").out.splitlines() == first.out.splitlines()[:-1]
    assert "PRIVATE" not in first.out
    again = shell("console", "tls", "--renew")
    assert again.code == 0, again
    renewed = open_authority(directory)
    assert renewed.name == "rossec.local"
    assert renewed.data != authority.data


def test_programs_read_it_as_json(shell: Shell) -> None:
    shell("console", "tls", "--renew", "--name", "rossec.local")
    found = json.loads(shell("console", "tls", "--json").out)
    assert found["name"] == "rossec.local"
    assert len(found["words"].split()) == 8


def test_the_first_name_is_that_of_the_host(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "hall.example.org")
    shell("console", "tls", "--renew")
    assert open_authority(shell.root / "ca" / "console").name == "hall.local"


def test_a_damaged_one_is_replaced_when_asked(shell: Shell) -> None:
    shell("console", "tls", "--renew", "--name", "rossec.local")
    key = shell.root / "ca" / "console" / KEY
    key.write_bytes(b"")
    refused(shell("console", "tls"), "is damaged", "--renew")
    assert shell("console", "tls", "--renew", "--name", "rossec.local").code == 0
    assert shell("console", "tls").code == 0


def test_a_beginner_s_mistakes(shell: Shell) -> None:
    refused(shell("console", "tls", "--name", "a.local"), "--name is for --renew", code=2)
    refused(shell("console", "tls", "--renew", "--name", "192.168.1.5"), "cannot belong to one")
