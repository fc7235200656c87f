"""A new identity gets at once what the policy gives its name, and only that."""

import pytest

from rossec.authority.home import AuthorityHome
from rossec.home import NodeHome
from tests.support.commands import Shell
from tests.support.refusingmaster import refuse_grants

POLICY = """rossec: 1
robot: r
rules:
  - {id: own, who: "/robot*", allow: {publish: [/odom]}}
  - {id: all, who: "*", allow: {graph: ["/**"]}, except: /other}
  - {id: lift, who: "*", prompt: {call: [/lift]}}
"""


def write(shell: Shell, text: str) -> None:
    (shell.root / "ca" / "policy.yaml").write_text(text)


def sign(shell: Shell, name: str, *options: str) -> list[str]:
    shell("node", "request", name)
    request = str(shell.node(name) / "node.csr")
    said = shell.unlocked("ca", "sign", request, "--yes", *options)
    assert said.code in {0, 3}, said
    return [*said.out.splitlines()[3:], *said.err.splitlines()]


def test_what_the_policy_gives_is_said_in_one_line(shell: Shell) -> None:
    write(shell, POLICY.replace('"/robot*"', "/robot"))
    signed, given, *delivered = sign(shell, "/robot")
    assert signed.startswith("signed /robot: ")
    assert given == "the policy gives /robot: publish /odom, graph /**"
    assert all(line.startswith("given to /robot in ") for line in delivered)
    assert len(NodeHome.of(shell.root, "/robot").grants()) == 2
    assert set(AuthorityHome.at(shell.root).store().policy_grants().values()) == {"own", "all"}
    assert "nothing to do" in shell("policy", "apply").out


def test_a_name_without_rules_gets_nothing(shell: Shell) -> None:
    write(shell, POLICY.replace('"/robot*"', "/robot"))
    assert len(sign(shell, "/other")) == 1
    assert AuthorityHome.at(shell.root).store().grants() == []


def test_without_a_policy_there_are_no_grants(shell: Shell) -> None:
    assert len(sign(shell, "/robot")) == 1


def test_a_policy_with_mistakes_is_a_note(shell: Shell) -> None:
    write(shell, POLICY.replace("allow", "alow"))
    _, note, hint = sign(shell, "/robot")
    assert note.startswith("rossec: /robot has no grants yet: ")
    assert hint == "rossec: correct it (rossec policy check), then: rossec policy apply"


def test_many_rights_are_counted(shell: Shell) -> None:
    names = ", ".join(f"/t{n}" for n in range(7))
    write(shell, POLICY.replace('"/robot*"', "/robot").replace("[/odom]", f"[{names}]"))
    assert sign(shell, "/robot")[1] == (
        "the policy gives /robot: publish /t0, publish /t1, publish /t2, publish /t3, publish /t4, and 3 more"
    )


def test_a_replaced_key_gets_its_own(shell: Shell) -> None:
    write(shell, POLICY.replace('"/robot*"', "/robot"))
    sign(shell, "/robot")
    old = NodeHome.of(shell.root, "/robot")
    for path in old.path.iterdir():
        if path.is_file():
            path.unlink()
    out = sign(shell, "/robot", "--replace-key", "/robot")
    assert "the policy gives /robot: publish /odom, graph /**" in out
    assert len(AuthorityHome.at(shell.root).store().policy_grants()) == 4
    assert "nothing to do" in shell("policy", "apply").out


def test_grants_that_the_master_refuses_are_a_note(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """The identity is signed by then."""
    write(shell, POLICY.replace('"/robot*"', "/robot"))
    shell("node", "request", "/robot")
    request = shell.root / "robot.csr"
    (shell.node("/robot") / "node.csr").rename(request)
    shell.node("/robot").rename(shell.root / "elsewhere")
    refuse_grants(monkeypatch)
    said = shell.unlocked("ca", "sign", str(request), "--yes")
    assert said.code == 0
    assert said.err.count("of /robot: no room\n") == 2
    assert "rossec: afterwards deliver it with: rossec grant deliver\n" in said.err
