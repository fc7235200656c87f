from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value, encode
from ca.keys.signing import KeySigner
from grants.document import GRANT, issuer_uri
from tests.support.commands import Shell, refused


@pytest.fixture
def robot(shell: Shell) -> Shell:
    shell.enroll("/robot")
    return shell


def test_an_unknown_or_ambiguous_id_is_not_revoked(robot: Shell) -> None:
    refused(robot.unlocked("grant", "revoke", "00"), "no grant begins with '00'", "grant list")
    refused(robot.unlocked("grant", "revoke", ""), "no grant begins with ''")
    for _ in range(2):
        robot.unlocked("grant", "sign", "/robot", "--publish", "/p")
    ids = [line.split()[0] for line in robot("grant", "list").out.splitlines()]
    common = "" if ids[0][0] != ids[1][0] else ids[0][0]
    if common:
        refused(robot.unlocked("grant", "revoke", common), "several grants begin")


@pytest.mark.parametrize("filters", [{7: {"clear": True}}, {"x": {7: True}}, {"x": {-1: {"a": 1}}}])
def test_a_filter_that_is_not_text_is_refused(
    robot: Shell, tmp_path: Path, filters: dict[int | str, Value]
) -> None:
    scope: list[Value] = [["/pose", 2, {0: "geometry_msgs/PoseStamped", 2: filters}]]
    claims: dict[int | str, Value] = {
        1: issuer_uri(bytes(32)),
        2: "/robot",
        3: "home",
        4: 2,
        5: 1,
        7: bytes(16),
        8: {5: bytes(32)},
        9: encode(scope),
        -65537: 2,
    }
    signer = KeySigner(ec.generate_private_key(ec.SECP256R1()))
    (tmp_path / "odd.grant").write_bytes(GRANT.sign(signer, claims))
    refused(robot("grant", "show", str(tmp_path / "odd.grant")), "in a grant: ")


def test_a_grant_is_shown_and_installed_from_its_file(robot: Shell, tmp_path: Path) -> None:
    out, pose = tmp_path / "p.grant", ("--type", "geometry_msgs/PoseStamped")
    sign = ("grant", "sign", "/robot", "--subscribe", "/pose", *pose, "--clear", "header.frame_id")
    robot.unlocked(*sign, "--out", str(out))
    number = robot("grant", "list").out.split()[0]
    shown = robot("grant", "show", str(out)).out.splitlines()
    assert shown[0] == f"grant {number} of home for /robot"
    assert shown[1].startswith("holds from ")
    assert shown[2:4] == ["may subscribe /pose", "  header.frame_id: clear"]
    (installed,) = (robot.node("/robot") / "grants").iterdir()
    installed.unlink()
    assert robot("grant", "install", str(out)).out == f"/robot holds grant {number}\n"
    assert installed.read_bytes() == out.read_bytes()


def test_a_changed_grant_is_not_installed(robot: Shell, tmp_path: Path) -> None:
    out = tmp_path / "p.grant"
    robot.unlocked("grant", "sign", "/robot", "--publish", "/p", "--out", str(out))
    (installed,) = (robot.node("/robot") / "grants").iterdir()
    installed.unlink()
    out.write_bytes(out.read_bytes()[:-1] + b"\0")
    refused(robot("grant", "install", str(out)), "signature")
    assert list((robot.node("/robot") / "grants").iterdir()) == []


def test_a_revoked_grant_is_published(robot: Shell) -> None:
    robot.unlocked("grant", "sign", "/robot", "--publish", "/p")
    grant_id = robot("grant", "list", "--master", "http://127.0.0.1:1").out.split()[0]
    said = robot.unlocked("grant", "revoke", grant_id[:8], "--master", "http://127.0.0.1:1")
    assert f"revoked {grant_id}" in said.out
    refused(said, "did not take the list", "rossec ca publish", code=3)


def test_a_file_that_is_no_grant_is_named_so(empty: Shell, tmp_path: Path) -> None:
    other = tmp_path / "node.pem"
    other.write_text("-----BEGIN CERTIFICATE-----")
    refused(empty("grant", "install", str(other)), "not a grant", "rossec grant")
