from pathlib import Path

import pytest

from rossec.cli.shared.context import Environment
from rossec.cli.shared.grant_delivery import deliver_grant
from tests.support.commands import Shell


def test_a_grant_is_given_to_a_node_of_this_host(
    shell: Shell, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shell.enroll("/robot")
    out = tmp_path / "p.grant"
    shell.unlocked("grant", "sign", "/robot", "--publish", "/p", "--out", str(out))
    (held,) = (shell.node("/robot") / "grants").iterdir()
    held.unlink()
    environment = Environment(shell.environ)
    deliver_grant(environment, "/robot", out.read_bytes(), None)
    assert [file.read_bytes() for file in held.parent.iterdir()] == [out.read_bytes()]
    assert capsys.readouterr().out == f"given to /robot in {shell.node('/robot')}\n"
    deliver_grant(environment, "/elsewhere", out.read_bytes(), None)
    assert "rossec grant install FILE" in capsys.readouterr().err
    copy = tmp_path / "copy"
    deliver_grant(environment, "/elsewhere", out.read_bytes(), copy)
    assert copy.read_bytes() == out.read_bytes()
    assert capsys.readouterr() == (f"written to {copy}\n", "")
