"""`rossec grant narrow`: from the grant of one node to the grants of another."""

import time
from pathlib import Path

import pytest

from grants.model import Grant, Right
from grants.token import Verifier
from rossec.home import NodeHome
from tests.support.commands import Shell, refused

POSE = ("--type", "geometry_msgs/PoseStamped")


@pytest.fixture
def fleet(shell: Shell) -> Shell:
    for name in ("/rounds/robot3", "/rounds/robot7"):
        shell.enroll(name)
    said = shell.unlocked(
        "grant",
        "sign",
        "/rounds/robot3",
        "--subscribe",
        "/robot/pose",
        "--call",
        "/robot/**",
        *POSE,
        "--round",
        "pose.position=1.0",
        "--may-narrow",
        "2",
        "--for",
        "2h",
        "--out",
        str(shell.root / "held.grant"),
    )
    assert said.code == 0, said.err
    return shell


def narrow(shell: Shell, *options: str, own: str = "/rounds/robot3", file: str = "held") -> str:
    """Hand a grant on; returns where the token is."""
    out = shell.root / f"{len(list(shell.root.glob('*.grant')))}.grant"
    said = shell(*arguments(shell, file, own, out), *options)
    assert said.code == 0, said.err
    assert f"written to {out}" in said.out
    return str(out)


def arguments(shell: Shell, file: str, own: str, out: Path) -> tuple[str, ...]:
    other = "/rounds/robot7" if own == "/rounds/robot3" else "/rounds/robot3"
    return (
        "grant",
        "narrow",
        str(shell.root / f"{file}.grant"),
        "--as",
        own,
        "--to",
        str(shell.node(other) / "node.pem"),
        "--out",
        str(out),
    )


def test_a_narrowed_grant_reaches_the_other_node(fleet: Shell) -> None:
    out = narrow(fleet, "--subscribe", "/robot/pose", *POSE, "--clear", "header.frame_id", "--for", "1h")
    said = fleet("grant", "install", out)
    assert said.out.startswith("/rounds/robot7 holds grant "), said.err
    (file,) = (fleet.node("/rounds/robot7") / "grants").iterdir()
    shown = fleet("grant", "show", str(file)).out
    assert "for /rounds/robot3:" in shown
    assert "pose.position: round step 1.0" in shown
    assert "narrowed for /rounds/robot7, which may also not do more than:" in shown
    assert "header.frame_id: clear" in shown
    grant = opened(fleet, file.read_bytes())
    assert [link.subject for link in grant.links] == ["/rounds/robot3", "/rounds/robot7"]
    assert file.name == f"{grant.id.hex()}.grant"
    assert grant.covers(Right.SUBSCRIBE, "/robot/pose")
    assert not grant.covers(Right.CALL, "/robot/x")
    assert grant.expires <= int(time.time()) + 3600
    doctor = fleet("doctor", "/rounds/robot7").out
    assert "may subscribe /robot/pose until" in doctor


def opened(shell: Shell, data: bytes) -> Grant:
    anchor = NodeHome.of(shell.root, "/rounds/robot7").anchor()
    verifier = Verifier(anchor.public_key, anchor.domain, (), 0, lambda *_: None)
    return verifier.open(data, int(time.time()))


def test_it_may_be_handed_on_again_and_ends_with_the_first(fleet: Shell) -> None:
    once = narrow(fleet, "--subscribe", "/**", "--may-narrow", "1", "--for", "300d")
    again = narrow(fleet, "--subscribe", "/robot/pose", own="/rounds/robot7", file=Path(once).stem)
    grant = opened(fleet, Path(again).read_bytes())
    assert len(grant.links) == 3
    assert len({link.expires for link in grant.links}) == 1
    assert "may be narrowed 1 times" in fleet("grant", "show", once).out
    said = fleet(
        *arguments(fleet, Path(again).stem, "/rounds/robot3", fleet.root / "x.grant"),
        "--subscribe",
        "/robot/pose",
    )
    refused(said, "allows 0 narrowings", "--may-narrow")


@pytest.mark.parametrize(
    ("options", "error", "hint"),
    [
        ((), "allows nothing", "--publish"),
        (("--publish", "/robot/pose"), "the grant gives no publish on /robot/pose", "grant show"),
        (("--subscribe", "/robot/pose", "--may-narrow", "2"), "allows 2 narrowings", "fewer"),
        (("--subscribe", "/robot/pose", "--clear", "header"), "need the message type", "--type"),
        (("--subscribe", "/robot/pose", *POSE, "--clear", "heador"), "heador", ""),
    ],
)
def test_mistakes_show_before_anything_is_signed(
    fleet: Shell, options: tuple[str, ...], error: str, hint: str
) -> None:
    out = fleet.root / "new.grant"
    refused(fleet(*arguments(fleet, "held", "/rounds/robot3", out), *options), error, hint)
    assert not out.exists()


def test_only_its_holder_hands_a_grant_on(fleet: Shell) -> None:
    wanted = ("--subscribe", "/robot/pose")
    out = fleet.root / "new.grant"
    said = fleet(*arguments(fleet, "held", "/rounds/robot7", out), *wanted)
    refused(said, "is not held by /rounds/robot7", "it is for /rounds/robot3")
    out.write_bytes(b"mine")
    said = fleet(*arguments(fleet, "held", "/rounds/robot3", out), *wanted)
    refused(said, "exists and is not overwritten")


def test_the_other_node_is_of_the_same_domain(
    fleet: Shell, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    abroad = Shell(tmp_path / "abroad", capsys)
    assert abroad.unlocked("ca", "init", "home").code == 0
    abroad.enroll("/rounds/robot7")
    out = fleet.root / "new.grant"
    given = [*arguments(fleet, "held", "/rounds/robot3", out), "--subscribe", "/robot/pose"]
    given[given.index("--to") + 1] = str(abroad.node("/rounds/robot7") / "node.pem")
    said = fleet(*given)
    assert said.code == 1
    assert said.err.startswith("rossec: error: ")
    assert not out.exists()


def test_a_chain_that_no_peer_would_read_is_not_written(fleet: Shell) -> None:
    many = [word for n in range(60) for word in ("--subscribe", f"/{'a' * 240}{n}/**")]
    wide = fleet.root / "wide.grant"
    said = fleet.unlocked("grant", "sign", "/rounds/robot3", *many, "--may-narrow", "2", "--out", str(wide))
    assert said.code == 0, said.err
    once = narrow(fleet, *many, "--may-narrow", "1", file="wide")
    out = fleet.root / "twice.grant"
    said = fleet(*arguments(fleet, Path(once).stem, "/rounds/robot7", out), *many)
    refused(said, "more than a node may present", "fewer rights")
    assert not out.exists()
