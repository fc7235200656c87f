"""`rossec ca revoke hospital:/rounds/robot3`: a key of another domain is refused in this one."""

from pathlib import Path

from tests.rossec.cli.ca.record import listed
from tests.rossec.cli.domain.sites import NOBODY, Neighbours
from tests.rossec.cli.grant.conftest import visit
from tests.support.commands import Said, Shell, refused

__all__ = ["visit"]
ROBOT3 = "/rounds/robot3"


def revoke(visit: Neighbours, *options: str, node: str = f"hospital:{ROBOT3}") -> Said:
    return visit.shell.unlocked("ca", "revoke", node, *NOBODY, *options)


def pem(visit: Neighbours, name: str = ROBOT3) -> tuple[str, str]:
    return "--certificate", str(visit.hospital.node(name) / "node.pem")


def grant(visit: Neighbours, out: Path, *options: str) -> Said:
    wish = ("--subscribe", "/robot/pose", "--out", str(out))
    return visit.shell.unlocked("grant", "sign", f"hospital:{ROBOT3}", *wish, *options)


def test_a_recorded_key_is_revoked_by_its_name(visit: Neighbours, tmp_path: Path) -> None:
    refused(revoke(visit), f"no certificate of hospital:{ROBOT3} is recorded", "--certificate")
    assert grant(visit, tmp_path / "a", *pem(visit)).code == 0
    said = revoke(visit, "--reason", "it bumps into chairs")
    assert said.out == f"revoked hospital:{ROBOT3}, 1 key (list 2)\n"
    refused(said, "did not take the list", "rossec ca publish", code=3)
    assert len(listed(visit.shell)) == 1
    refused(revoke(visit), "is revoked already", "rossec ca publish")
    refused(grant(visit, tmp_path / "b", *pem(visit)), "is revoked", "new key")
    assert visit.shell("ca", "log", "verify").code == 0


def test_a_key_is_revoked_by_its_certificate(visit: Neighbours) -> None:
    refused(revoke(visit, *pem(visit, "/rounds/robot7")), "that of hospital:/rounds/robot7")
    refused(revoke(visit, *pem(visit), node=ROBOT3), "a node of this domain", "LABEL:/NAME")
    refused(revoke(visit, *pem(visit), node=f"clinic:{ROBOT3}"), "no domain is called 'clinic'")
    assert listed(visit.shell) == frozenset()
    said = revoke(visit, *pem(visit), node=f"/remote/hospital{ROBOT3}")
    assert said.out == f"revoked hospital:{ROBOT3}, 1 key (list 2)\n"
    refused(revoke(visit), "is revoked already")
    assert len(listed(visit.shell)) == 1


def test_the_other_domain_goes_on(visit: Neighbours) -> None:
    revoke(visit, *pem(visit))
    assert listed(visit.hospital) == frozenset()
    other: Shell = visit.hospital
    assert ROBOT3 in other("ca", "list").out
