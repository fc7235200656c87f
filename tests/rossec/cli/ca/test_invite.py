from pathlib import Path

import pytest

from ca.enrollment import invitation
from ca.enrollment import invitation as ndef
from rossec.authority.home import AuthorityHome
from tests.support.commands import Shell, refused
from tests.support.keyservice import running_service

POLICY = """rossec: 1
robot: fleet
identities: {scanners: {node: "/fleet/**"}, base: {node: /base}}
types: {}
rules:
  - {id: scans, who: scanners, allow: {publish: [/scan]}}
  - {id: maps, who: base, allow: {publish: [/map]}}
"""


def test_exactly_one_line_is_printed(shell: Shell) -> None:
    said = shell("ca", "invite", "/fleet/*", "--uses", "3", "--address", "10.0.0.1")
    assert said.code == 0, said.err
    assert said.out.count("\n") == 1
    code = invitation.parse(said.out)
    assert (code.pattern, code.address, code.wildcard) == ("/fleet/*", "10.0.0.1:11318", False)
    [row] = AuthorityHome.at(shell.root).store().invitations.all()
    assert (row.id, row.key, row.uses, row.expires) == (code.id, code.key, 3, code.expires)
    assert row.expires == row.at + 3600
    assert f"invitation {code.id.hex()[:8]}: 3 nodes named /fleet/*, until " in said.err
    assert "there is no policy: they are granted nothing" in said.err
    assert code.secret not in (shell.root / "ca" / "ca.db").read_bytes()


def test_no_key_is_needed_and_this_host_is_the_address(shell: Shell) -> None:
    said = shell("ca", "invite", "/rviz", "--anonymous")
    code = invitation.parse(said.out)
    assert (code.address, code.wildcard) == ("127.0.0.1:11318", True)
    assert "one node named /rviz, for anonymous nodes too" in said.err


def test_the_port_is_that_of_the_service_that_runs(shell: Shell) -> None:
    home, ports = AuthorityHome.at(shell.root), iter((7000, 0))
    with running_service(home, join_port=lambda: next(ports)):
        for expected in ("127.0.0.1:7000", "127.0.0.1:11318"):
            assert invitation.parse(shell("ca", "invite", "/a").out).address == expected


def test_what_the_policy_gives_the_names(shell: Shell) -> None:
    (shell.root / "ca" / "policy.yaml").write_text(POLICY)
    said = shell("ca", "invite", "/fleet/*")
    assert said.code == 0, said.err
    assert "scanners: allow publish /scan (rule scans)" in said.err
    assert "/map" not in said.err
    said = shell("ca", "invite", "/unknown")
    assert "the policy has no rule for them: deny" in said.err


def test_a_policy_with_mistakes_makes_no_invitation(shell: Shell) -> None:
    (shell.root / "ca" / "policy.yaml").write_text("rules: 7\n")
    assert shell("ca", "invite", "/fleet/*").code == 1
    assert AuthorityHome.at(shell.root).store().invitations.all() == []


def test_a_picture_and_a_tag(shell: Shell, tmp_path: Path) -> None:
    tag = tmp_path / "tag"
    said = shell("ca", "invite", "/fleet/*", "--qr", "--ndef", str(tag))
    assert said.out.count("\n") == 1
    assert "\u2580" in said.err
    assert ndef.read(tag.read_bytes()).text() == said.out.strip()
    assert tag.stat().st_mode & 0o077 == 0
    refused(shell("ca", "invite", "/fleet/*", "--ndef", str(tag)), "is not overwritten")


@pytest.mark.parametrize(
    ("words", "error", "hint"),
    [
        (["fleet"], "not a name pattern", "/robot1/**"),
        (["/master"], "/master is reserved", "rossec node enroll /master"),
        (["/relay/*"], "/relay/* is reserved", "rossec node enroll /relay/name"),
        (["/gateway/*"], "/gateway/* is reserved", "rossec node enroll /gateway/name"),
        (["/ca", "--anonymous"], "cannot have a wildcard tail", "a name of their own"),
        (["/a", "--address", "a b"], "is not an address", "192.168.1.7"),
        (["/a", "--address", "h" * 63 + ".example"], "1 to 64 characters", "shorter"),
    ],
)
def test_what_is_refused(shell: Shell, words: list[str], error: str, hint: str) -> None:
    refused(shell("ca", "invite", *words), error, hint)
    assert AuthorityHome.at(shell.root).store().invitations.all() == []


def test_how_much_at_most(shell: Shell) -> None:
    assert shell("ca", "invite", "/a", "--for", "31d").code == 2
    assert shell("ca", "invite", "/a", "--uses", "0").code == 2
    assert shell("ca", "invite", "/a", "--uses", "10001").code == 2


def test_without_an_authority(empty: Shell) -> None:
    refused(empty("ca", "invite", "/a"), "there is no authority", "rossec ca init")
