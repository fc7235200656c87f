"""A home and a backup that release 0.1.0 wrote are read, go on and come back.

`tests/vectors/homes/1.tar.gz` was written by the commands of that release, in November 2026: an
authority that signed four nodes, gave two grants and revoked /doctor, a master that was ended,
and a backup. Its passphrase is the one below. Everything happens a minute later.
"""

import subprocess
from pathlib import Path
from typing import Final

import pytest

from ca.errors import Revoked
from ca.revocation.lists import Timestamp, digest
from ca.revocation.trust_status import Revocations
from grants import document
from grants.model import Right
from rossec.authority.backup import restore
from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService, ThingOrder
from rossec.authority.signing import IN_FORCE
from rossec.home import NodeHome
from rossec.host import audit
from tests.vectors.make_things import KEY

ARCHIVE: Final = Path(__file__).parents[1] / "vectors" / "homes" / "1.tar.gz"
PASSPHRASE: Final = "correct horse battery staple"
NOW: Final = 1_795_338_230


@pytest.fixture
def home(tmp_path: Path) -> Path:
    subprocess.run(["tar", "-xpzf", ARCHIVE, "-C", tmp_path, "--no-same-owner"], check=True)
    return tmp_path / "home"


def test_the_authority_goes_on(home: Path) -> None:
    place = AuthorityHome(home / "ca")
    unlocked = place.unlock(PASSPHRASE)
    unlocked.store.log.audit(unlocked.signer.public_key)
    assert unlocked.store.identities.valid("/doctor", NOW) == []
    (robot,) = unlocked.store.identities.valid("/robot", NOW)
    unlocked.revoke(robot.thumbprint, "sold", NOW)
    revocations = Revocations(place.own_key())
    revocations.update(place.revocation_list(), NOW)
    assert robot.thumbprint in revocations.entries
    assert len(revocations.entries) == 2
    unlocked.store.log.audit(unlocked.signer.public_key)


def test_the_authority_can_say_what_a_thing_is(home: Path) -> None:
    place = AuthorityHome(home / "ca")
    service = AuthorityService(home, lambda: PASSPHRASE, lambda _: None, lambda: NOW)
    service.things.sign(ThingOrder("/things/lamp", "/robot", KEY, 60))
    assert [each.state for each in service.things.states()] == [IN_FORCE]
    service.unlock().store.log.audit(place.own_key())
    service.close()


def test_a_node_goes_on(home: Path) -> None:
    node = NodeHome.of(home, "/heating")
    identity, anchor = node.identity(NOW), node.anchor()
    (data,) = node.grants()
    grant = document.open_grant(data, anchor.public_key, NOW, domain="home")
    assert grant.holder == identity.thumbprint
    (permission,) = grant.permissions
    assert permission.covers(Right.SUBSCRIBE, "/robot/pose")
    assert permission.restriction is not None
    assert [rule.path for rule in permission.restriction.filters] == ["header.frame_id", "pose.position"]


def test_what_a_node_has_seen_revoked_stays_revoked(home: Path) -> None:
    node, doctor = NodeHome.of(home, "/robot"), NodeHome.of(home, "/doctor")
    revocations = Revocations(node.anchor().public_key)
    saved = node.load_revocations()
    assert saved is not None
    revocations.update(saved, NOW)
    assert revocations.current is not None
    revocations.confirm(Timestamp(revocations.current.seq, digest(saved), NOW, 30), NOW)
    revocations.check(node.identity(NOW).thumbprint, NOW)
    with pytest.raises(Revoked):
        revocations.check(doctor.identity(NOW).thumbprint, NOW)


def test_the_masters_audit_is_read(home: Path) -> None:
    lines = (home / "nodes" / "master" / "audit.log").read_text().splitlines()
    entries, damaged = audit.read_entries(lines)
    assert (len(entries), damaged) == (4, [])
    assert audit.verify(entries) == entries[-1]["hash"]


def test_the_backup_comes_back(home: Path, tmp_path: Path) -> None:
    done = restore(tmp_path / "again", (tmp_path / "authority.backup").read_bytes(), PASSPHRASE, NOW)
    unlocked = done.home.unlock(PASSPHRASE)
    unlocked.store.log.audit(unlocked.signer.public_key)
    assert len(unlocked.store.grants()) == 2
    assert done.home.anchor() == AuthorityHome(home / "ca").anchor()
