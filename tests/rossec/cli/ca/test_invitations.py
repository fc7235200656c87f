import json

from ca.enrollment import invitation
from rossec.authority.home import AuthorityHome
from tests.support.commands import PASSPHRASE, Shell, refused
from tests.support.joining import JoinPort

NO_MASTER = ("--master", "http://127.0.0.1:9")


def invited(shell: Shell, port: JoinPort, *words: str) -> tuple[str, str]:
    """The code, and the first digits of the id."""
    said = shell("ca", "invite", *words, "--address", port.address)
    assert said.code == 0, said.err
    return said.out, invitation.parse(said.out).id.hex()[:8]


def joined(shell: Shell, code: str, name: str) -> None:
    file = shell.root / "code"
    file.write_text(code)
    file.chmod(0o600)
    said = shell("node", "join", "--file", str(file), "--name", name)
    assert said.code == 0, said.err


def test_without_invitations_none_are_listed(shell: Shell) -> None:
    assert shell("ca", "invitations").out == "no open invitations\n"
    assert shell("ca", "invitations", "--all").out == "no invitations\n"
    assert shell("ca", "invitations", "--json").out == "[]\n"


def test_invitations_and_who_joined_are_listed(shell: Shell) -> None:
    with JoinPort(shell.root, PASSPHRASE) as port:
        code, short = invited(shell, port, "/fleet/*", "--uses", "2")
        joined(shell, code, "/fleet/a")
        _, rviz = invited(shell, port, "/rviz", "--anonymous")
    lines = shell("ca", "invitations").out.splitlines()
    assert lines[0].startswith(f"{short}  open  /fleet/*  1 of 2 joined  until ")
    assert lines[1].startswith("  /fleet/a  ")
    assert lines[2].startswith(f"{rviz}  open  /rviz  0 of 1 joined")
    assert lines[2].endswith("for anonymous nodes too")
    first, second = json.loads(shell("ca", "invitations", "--json").out)
    assert (first["state"], first["uses"], first["pattern"]) == ("open", 2, "/fleet/*")
    assert [use["name"] for use in first["joined"]] == ["/fleet/a"]
    assert second["anonymous"]
    with JoinPort(shell.root, PASSPHRASE):
        assert code not in shell("ca", "invitations", "--all", "--json").out


def test_an_invitation_is_ended_without_the_key(shell: Shell) -> None:
    with JoinPort(shell.root, PASSPHRASE) as port:
        code, short = invited(shell, port, "/fleet/*", "--uses", "2")
        joined(shell, code, "/fleet/a")
        said = shell("ca", "invitations", "revoke", short, "--reason", "lost")
        assert said.out == f"invitation {short} is ended\n"
        assert "1 joined by it and stay enrolled; to revoke them: --and-nodes" in said.err
        refused(
            shell("node", "join", "--file", str(shell.root / "code"), "--name", "/fleet/b"), "was revoked"
        )
    assert shell("ca", "invitations").out == "no open invitations\n"
    [row] = json.loads(shell("ca", "invitations", "--all", "--json").out)
    assert (row["state"], row["reason"]) == ("ended", "lost")
    refused(shell("ca", "invitations", "revoke", "zz"), "no invitation begins", "invitations")


def test_who_joined_is_revoked_too(shell: Shell) -> None:
    with JoinPort(shell.root, PASSPHRASE) as port:
        code, short = invited(shell, port, "/fleet/*", "--uses", "3")
        joined(shell, code, "/fleet/a")
        said = shell.unlocked("ca", "invitations", "revoke", short, "--and-nodes", *NO_MASTER)
        assert said.code == 3
        assert said.out == f"invitation {short} is ended\nrevoked /fleet/a\n"
        again = shell.unlocked("ca", "invitations", "revoke", short, "--and-nodes", *NO_MASTER)
        assert again.code == 0
        assert "no node that joined by it is left to revoke" in again.out


def test_an_invitation_ends_also_if_the_key_cannot_be_used(shell: Shell) -> None:
    """The code may be in the hands of somebody who uses it while a passphrase is looked for."""
    with JoinPort(shell.root, PASSPHRASE) as port:
        code, short = invited(shell, port, "/fleet/*", "--uses", "3")
        joined(shell, code, "/fleet/a")
    wrong = shell.root / "wrong"
    wrong.write_text("not the passphrase")
    wrong.chmod(0o600)
    words = ("ca", "invitations", "revoke", short, "--and-nodes", "--passphrase-file", str(wrong))
    refused(shell(*words), "passphrase does not open")
    assert shell("ca", "invitations").out == "no open invitations\n"


def test_what_waits_is_denied(shell: Shell) -> None:
    shell.enroll("/fleet/a")
    shell.node("/fleet/a").rename(shell.root / "old")
    with JoinPort(shell.root, PASSPHRASE) as port:
        code, short = invited(shell, port, "/fleet/*")
        file = shell.root / "code"
        file.write_text(code)
        file.chmod(0o600)
        ask = ("node", "join", "--file", str(file), "--name", "/fleet/a")
        assert shell(*ask).code == 5
        assert "denied 1 request that waited" in shell("ca", "invitations", "revoke", short).out
        refused(shell(*ask), "was denied", "new key")
    assert AuthorityHome.at(shell.root).store().requests.open() == []
