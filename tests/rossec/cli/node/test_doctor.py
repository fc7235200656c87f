import asyncio
import secrets
import time
from pathlib import Path

import pytest

from ca.authority import Authority
from ca.certificates import Identity, to_pem
from ca.intermediates import build_intermediate_request
from ca.keys.key_files import generate
from ca.keys.signer import KeySigner
from grants.model import Right
from rossec.authority.home import AuthorityHome
from rossec.cli.main import run
from rossec.home import NodeHome
from tests.rossec.cli.ca.test_intermediate import NOBODY
from tests.support import trust
from tests.support.attacker import call, credentials
from tests.support.commands import Shell
from tests.support.site import DAY, Site


async def bring(site: Site, data: bytes) -> None:
    """Somebody carries a list to the master."""
    assert site.master is not None
    own = credentials(site, "/carrier")
    await call(site.master.uri, own, "rossec.updateRevocations", "/carrier", data)


async def test_a_node_in_order_and_its_faults(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    async with Site(tmp_path / "site").running() as site:
        environ = dict(site.environ)

        async def doctor(*words: str, **more: str) -> tuple[int, str]:
            code = await asyncio.to_thread(run, ["doctor", *words], {**environ, **more})
            return code, "".join(capsys.readouterr())

        code, said = await doctor("/robot", "--offline")
        assert code == 1
        assert "not ok  /robot has no ca.pem" in said
        site.enroll("/robot")
        code, said = await doctor("/robot")
        assert code == 1
        assert "not ok  no grants: it may do nothing" in said
        site.enroll("/relay")
        code, said = await doctor("/relay")
        assert code == 0, said
        assert "ok      no grants: a relay needs none" in said
        site.publish("/robot", "/x")
        code, said = await doctor("/robot", ROSSEC_ALLOW_PLAIN="/open")
        assert code == 0
        assert "ok      /robot of home until" in said
        assert "ok      may publish /x until" in said
        assert "has a fresh revocation list" in said
        assert "PLAIN   /open is neither encrypted nor checked" in said
        async with site.node("/other") as other:
            code, said = await doctor("/robot", ROS_MASTER_URI=other.uri)
            assert code == 1
            assert "not ok  /other answers there" in said
        home = site.enroll("/robot")
        home.install(site.authority.issue(home.request(), site.now(), 86400), site.now())
        assert isinstance(site.identity("/robot"), Identity)
        await bring(site, site.revoke(site.identity("/other").thumbprint))
        code, said = await doctor("/other")
        assert code == 1
        assert "not ok  the master says that this identity is revoked" in said
        code, said = await doctor("/robot", ROS_MASTER_URI="http://127.0.0.1:1")
        assert code == 1
        assert "1 of 4 checks failed" in said
        code, said = await doctor("/robot", ROSSEC_POST_QUANTUM="often")
        assert code == 1
        assert "ROSSEC_POST_QUANTUM is 'often'" in said
        (tmp_path / "odd.toml").write_bytes(b"\xff")
        code, said = await doctor("/robot", ROSSEC_CONFIG=str(tmp_path / "odd.toml"))
        assert code == 1
        assert "the options' file is not TOML" in said


async def test_an_identity_that_expires_soon_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = [0.0]
    import time

    clock[0] = time.time() - 3500
    site = Site(tmp_path / "site", clock=lambda: clock[0])
    site.enroll("/robot", lifetime=3700)
    (site.root / "rossec.toml").write_text('[rospy]\nallow_plain = ["/f"]\n')
    assert run(["doctor", "/robot", "--offline"], {"ROSSEC_HOME": str(site.root)}) == 1
    said = "".join(capsys.readouterr())
    assert "the identity ends soon" in said
    assert "PLAIN   /f" in said


def doctor(shell: Shell) -> list[str]:
    """What is said of /robot without a master."""
    said = shell("doctor", "/robot", "--offline")
    return [line for line in (said.out + said.err).splitlines() if "PLAIN" not in line]


def granted(shell: Shell, topic: str) -> str:
    said = shell.unlocked("grant", "sign", "/robot", "--publish", topic)
    return said.out.split()[1]


def test_a_revocation_in_the_local_authoritys_record_is_not_ok(shell: Shell) -> None:
    shell.enroll("/robot")
    first, second = granted(shell, "/one"), granted(shell, "/two")
    assert shell("doctor", "/robot", "--offline").code == 0
    shell.unlocked("grant", "revoke", first, *NOBODY)
    lines = doctor(shell)
    assert any(line.startswith("ok      may publish /two") for line in lines)
    assert not any("publish /one" in line for line in lines)
    record = f"according to the authority's record in {shell.root / 'ca'}"
    assert f"not ok  grant {first[:8]} is revoked {record}" in lines
    shell.unlocked("grant", "revoke", second, *NOBODY)
    assert any(line.endswith(f"{record} (and 1 more)") for line in doctor(shell))
    shell.unlocked("ca", "revoke", "/robot", *NOBODY)
    assert f"not ok  the key of /robot is revoked {record}" in doctor(shell)
    assert shell("doctor", "/robot", "--offline").code == 1


@pytest.mark.parametrize("tree", [False, True])
@pytest.mark.parametrize("where", ["/robot", "/master"])
def test_a_revocation_in_a_signed_list_is_not_ok(
    shell: Shell, where: str, tree: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0 if tree else 4096)
    shell.enroll("/robot")
    granted(shell, "/one")
    authority = AuthorityHome.at(shell.root)
    shell.unlocked("ca", "revoke", "/robot", *NOBODY)
    place = NodeHome.of(shell.root, where)
    place.path.mkdir(exist_ok=True)
    place.save_revocations(authority.revocation_list())
    if tree:
        place.save_entries(authority.newest_statement()[1])
    (shell.root / "ca").rename(shell.root / "elsewhere")
    assert f"not ok  the key of /robot is revoked according to the list in {place.path}" in doctor(
        shell
    )


def test_a_list_of_another_authority_is_ignored(shell: Shell, tmp_path: Path) -> None:
    shell.enroll("/robot")
    granted(shell, "/one")
    home, other = NodeHome.of(shell.root, "/robot"), Site(tmp_path / "other")
    home.save_revocations(other.revoke(home.identity(int(time.time())).thumbprint))
    assert shell("doctor", "/robot", "--offline").code == 0
    (shell.root / "ca" / "ca.pem").write_bytes((other.enroll("/x").path / "ca.pem").read_bytes())
    AuthorityHome.at(shell.root).store().revoke(
        home.identity(int(time.time())).thumbprint, "of another", int(time.time())
    )
    assert shell("doctor", "/robot", "--offline").code == 0


def test_a_node_below_a_revoked_intermediate_is_not_ok(shell: Shell, tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    signer, now = KeySigner(generate()), int(time.time())
    der = site.authority.authority.issue_intermediate(
        build_intermediate_request(signer, "home"),
        now=now, serial=secrets.randbits(127), may_enroll=True, lifetime=90 * DAY,
    )  # fmt: skip
    host = Authority(signer, site.anchor.certificate, der)
    home = NodeHome.of(site.root, "/robot")
    home.create_request("home")
    leaf = host.issue(home.request(), now=now, serial=secrets.randbits(127))
    home.install(to_pem(leaf, der, site.anchor.certificate), now)
    home.save_revocations(site.revoke(home.identity(now).issuers[0]))
    assert run(["doctor", "/robot", "--offline"], {"ROSSEC_HOME": str(site.root)}) == 1
    said = shell._capsys.readouterr().out
    assert "not ok  the intermediate's key of /robot is revoked according to the list in" in said


async def test_a_master_needs_no_grants_and_is_not_taken_for_an_impostor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    async with Site(tmp_path / "site").running() as site:
        code = await asyncio.to_thread(run, ["doctor", "/master"], dict(site.environ))
        said = "".join(capsys.readouterr())
        assert code == 0, said
        assert "ok      no grants: within its own domain a master needs none" in said
        assert "rossec master status" in said


def test_a_grant_of_another_domain_is_shown_by_its_label(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site, origin = Site(tmp_path / "site"), Site(tmp_path / "origin", "hospital")
    trust.accept(origin, site)
    data = trust.share(origin, site, "/viewer", Right.SUBSCRIBE, "/pose")
    site.enroll("/viewer").add_grant(data[-16:], data)
    run(["doctor", "/viewer", "--offline"], dict(site.environ))
    assert "may subscribe hospital:/pose until" in "".join(capsys.readouterr())
