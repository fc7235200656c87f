"""`rossec grant sign hospital:/rounds/robot3`: the way of a grant to another domain, and on."""

from pathlib import Path

import pytest

from grants.model import Right
from grants.token import peek
from rossec.home import NodeHome
from tests.rossec.cli.domain.sites import Neighbours
from tests.support.commands import Said, refused

ROBOT3, ROBOT7 = "/rounds/robot3", "/rounds/robot7"
WISH = ("--subscribe", "/robot/pose")


def sign(visit: Neighbours, *options: str, node: str = f"hospital:{ROBOT3}") -> Said:
    return visit.shell.unlocked("grant", "sign", node, *WISH, *options)


def certificate(visit: Neighbours, name: str = ROBOT3) -> tuple[str, str]:
    return "--certificate", str(visit.hospital.node(name) / "node.pem")


def test_a_grant_goes_to_another_domain_and_is_handed_on_there(visit: Neighbours, tmp_path: Path) -> None:
    out = tmp_path / "visit.grant"
    said = sign(visit, *certificate(visit), "--may-narrow", "1", "--out", str(out), "--for", "30d")
    assert said.code == 0, said.err
    assert f"for hospital:{ROBOT3} until" in said.out
    grant = peek(out.read_bytes())
    assert (grant.domain, grant.subject) == ("home", f"/remote/hospital{ROBOT3}")
    assert grant.cap == grant.expires
    robot = NodeHome.of(visit.hospital.root, ROBOT3)
    assert visit.hospital("grant", "install", str(out)).out.startswith(f"{ROBOT3} holds grant")
    assert [path.name for path in robot.grant_files()] == [f"{grant.id.hex()}.grant"]
    narrowed = tmp_path / "narrowed.grant"
    said = visit.hospital(
        "grant",
        "narrow",
        str(out),
        "--as",
        ROBOT3,
        "--out",
        str(narrowed),
        *WISH,
        "--to",
        str(visit.hospital.node(ROBOT7) / "node.pem"),
    )
    assert said.code == 0, said.err
    assert visit.hospital("grant", "install", str(narrowed)).code == 0
    chain = peek(narrowed.read_bytes())
    assert [link.subject for link in chain.links] == [f"/remote/hospital{ROBOT3}", ROBOT7]
    assert visit.shell("ca", "log", "verify").code == 0


def test_the_certificate_is_recorded_and_need_not_be_given_again(visit: Neighbours, tmp_path: Path) -> None:
    refused(sign(visit, "--out", str(tmp_path / "a")), "no valid certificate", "--certificate")
    unknown = sign(visit, "--out", str(tmp_path / "a"), node=f"clinic:{ROBOT3}")
    refused(unknown, "no domain is called 'clinic' here", "rossec domain list")
    assert sign(visit, *certificate(visit), "--out", str(tmp_path / "b")).code == 0
    assert sign(visit, "--out", str(tmp_path / "c")).code == 0
    first, again = (peek((tmp_path / name).read_bytes()) for name in "bc")
    assert first.holder == again.holder
    assert again.covers(Right.SUBSCRIBE, "/robot/pose")


def test_what_a_certificate_does_not_prove_is_not_signed(visit: Neighbours, tmp_path: Path) -> None:
    out = ("--out", str(tmp_path / "x.grant"))
    refused(sign(visit, *certificate(visit, ROBOT7), *out), f"that of hospital:{ROBOT7}", "name")
    kitchen = sign(visit, *certificate(visit, "/kitchen"), *out, node="hospital:/kitchen")
    refused(kitchen, "hospital:/kitchen is not admitted here", "rossec domain")
    clinic = sign(visit, *certificate(visit), *out, node=f"clinic:{ROBOT3}")
    refused(clinic, "no domain is called 'clinic' here", "rossec domain list")
    refused(sign(visit, *certificate(visit), *out, node=ROBOT3), "is a node of this domain", "LABEL")
    refused(sign(visit, *certificate(visit)), "no master of this domain delivers", "--out")
    refused(sign(visit, *certificate(visit), *out, "--renew-until", "90d"), "not renewed", "--for")
    refused(sign(visit, *certificate(visit), *out, node="hospital:robot"), "robot", "")
    assert not (tmp_path / "x.grant").exists()
    gone = visit.change("remove", "hospital")
    assert gone.code in (0, 3), gone
    refused(sign(visit, *certificate(visit), *out), "no domain is called 'hospital'", "")


@pytest.mark.parametrize("right", ["subscribe", "call", "publish", "admin", "param-get"])
def test_no_right_on_names_of_others_is_signed(visit: Neighbours, right: str) -> None:
    visit.shell.enroll("/robot")
    said = visit.shell.unlocked("grant", "sign", "/robot", f"--{right}", "/remote/hospital/**")
    refused(said, "is a name of another domain", "only --graph")


POLICY = """rossec: 1
robot: r
rules:
  - {id: visit, who: "hospital:/rounds/*", allow: {subscribe: [/robot/pose]}, lifetime: 1d,
     renew_until: 30d}
  - {id: own, who: "*", allow: {subscribe: [/map]}, lifetime: 1d}
"""


def test_a_policy_gives_rights_to_foreigners_it_names(visit: Neighbours, tmp_path: Path) -> None:
    assert sign(visit, *certificate(visit), "--out", str(tmp_path / "hand.grant")).code == 0
    (visit.shell.root / "ca" / "policy.yaml").write_text(POLICY)
    planned = visit.shell("policy", "apply", "--dry-run").out
    assert f"hospital:{ROBOT3}" in planned
    assert "/map" not in planned.split(f"hospital:{ROBOT3}")[1]
    said = visit.shell.unlocked("policy", "apply", "--yes", "--master", "http://127.0.0.1:1")
    outgoing = visit.shell.root / "ca" / "outgoing"
    assert str(outgoing) in said.out
    (file,) = outgoing.iterdir()
    grant = peek(file.read_bytes())
    assert grant.subject == f"/remote/hospital{ROBOT3}"
    assert [each.pattern for each in grant.permissions] == ["/robot/pose"]
    assert grant.cap == grant.expires  # nobody renews it
    again = visit.shell("policy", "apply", "--dry-run").out
    assert "+" not in again
    said = visit.shell("explain", f"hospital:{ROBOT3}", "subscribe", "/map")
    explained = said.out + said.err
    assert "DENY" in explained
    said = visit.shell("explain", f"hospital:{ROBOT3}", "subscribe", "/robot/pose")
    assert "ALLOW" in said.out
