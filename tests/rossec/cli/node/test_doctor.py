import asyncio
import json
import secrets
import shutil
import time
from dataclasses import replace
from pathlib import Path

import pytest

from ca.authority import Authority
from ca.certificates import Identity, build_intermediate_request, to_pem
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner, Signer
from ca.revocation.lists import Timestamp, sign_timestamp
from grants import document
from grants.model import Right
from rossec.authority.home import AuthorityHome
from rossec.cli.main import run
from rossec.errors import MasterNotFound
from rossec.home import NodeHome
from tests.rossec.cli.ca.test_intermediate import NOBODY
from tests.support import trust
from tests.support.attacker import call, credentials
from tests.support.commands import Shell, refused
from tests.support.discovered import Searches
from tests.support.site import DAY, Site


async def bring(site: Site, data: bytes) -> None:
    """Somebody carries a list to the master."""
    assert site.master is not None
    own = credentials(site, "/carrier")
    await call(site.master.uri, own, "rossec.updateRevocations", "/carrier", data)


def elsewhere(site: Site, directory: Path, name: str) -> Path:
    """The home of another host, on which only this node is."""
    home = NodeHome.of(site.root, name).path
    shutil.copytree(home, directory / "away" / "nodes" / home.name)
    (directory / "away").chmod(0o700)
    return directory / "away"


async def test_a_node_in_order_and_its_faults(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
        site.revoke(site.identity("/other").thumbprint)
        await bring(site, site.revoke(site.identity("/third").thumbprint))
        away = str(elsewhere(site, tmp_path, "/third"))
        code, said = await doctor("/third", ROSSEC_HOME=away)
        assert code == 1
        assert "not ok  the master says that this identity is revoked: /third, by list" in said
        assert "rossec node request /third" in said
        code, said = await doctor("/robot", ROS_MASTER_URI="http://127.0.0.1:1")
        assert code == 1
        assert "1 of 5 checks failed" in said
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
    assert "the identity ends soon, in 3m" in said
    assert "rossec ca renew /robot, then here: rossec node install FILE" in said
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
    assert f"not ok  the key of /robot is revoked according to the list in {place.path}" in doctor(shell)


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
        now=now,
        serial=secrets.randbits(127),
        may_enroll=True,
        lifetime=90 * DAY,
    )
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


def test_every_node_of_this_machine_is_checked(shell: Shell) -> None:
    for name in ("/robot", "/arm/left"):
        shell.enroll(name)
    said = shell("doctor", "--offline")
    assert said.code == 1
    lines = said.out.splitlines()
    assert sum("/robot of home until" in line for line in lines) == 1
    assert "not ok  /arm/left: no grants: it may do nothing" in lines
    assert "not ok  /robot: no grants: it may do nothing" in lines
    assert "of 8 checks failed" in said.err


def test_what_several_nodes_have_in_common_is_said_once(shell: Shell) -> None:
    for name in ("/robot", "/arm"):
        shell.enroll(name)
    shell.environ["ROS_MASTER_URI"] = "http://127.0.0.1:1"
    said = shell("doctor")
    assert sum("cannot connect to 127.0.0.1 port 1" in line for line in said.out.splitlines()) == 1
    found = json.loads(shell("doctor", "--json").out)
    assert {finding["node"] for finding in found["findings"]} == {"/robot", "/arm"}
    assert found["plain"] == []
    alone = shell("doctor", "/arm", "--json")
    assert {finding["node"] for finding in json.loads(alone.out)["findings"]} == {"/arm"}


def test_a_machine_without_nodes(empty: Shell) -> None:
    refused(empty("doctor"), "there is no node in", "rossec node request /NAME")


async def test_a_grant_that_only_the_master_knows_to_be_revoked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    async with Site(tmp_path / "site").running() as site:
        site.publish("/robot", "/kept")
        data = site.publish("/robot", "/x")
        await bring(site, site.revoke(data))
        environ = {**site.environ, "ROSSEC_HOME": str(elsewhere(site, tmp_path, "/robot"))}
        code = await asyncio.to_thread(run, ["doctor", "/robot"], environ)
        said = "".join(capsys.readouterr())
        assert code == 1
        short = document.grant_id(data).hex()[:8]
        assert f"not ok  grant {short} is revoked according to the master's list" in said
        assert said.count("not ok") == 1


async def test_a_revoked_identity_is_said_to_be_revoked_though_no_master_answers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site = Site(tmp_path / "site")
    site.enroll("/robot").save_revocations(site.revoke(site.identity("/robot").thumbprint))
    environ = {**site.environ, "ROS_MASTER_URI": "http://127.0.0.1:1"}
    assert await asyncio.to_thread(run, ["doctor", "/robot", "--json"], environ) == 1
    (faults,) = [
        [each for each in json.loads(line)["findings"] if not each["ok"]]
        for line in capsys.readouterr().out.splitlines()
    ]
    assert [(each["check"], "is revoked" in each["text"]) for each in faults] == [("identity", True)]


@pytest.mark.parametrize(("shift", "said"), [(-3600, "ahead of"), (3600, "behind")])
async def test_a_clock_that_is_off_is_the_one_fault(
    shift: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def shifted(signer: Signer, stamp: Timestamp) -> bytes:
        return sign_timestamp(signer, replace(stamp, issued=stamp.issued + shift))

    async with Site(tmp_path / "site").running() as site:
        site.publish("/robot", "/x")
        site.publish("/arm", "/x")
        monkeypatch.setattr("rossec.master.rights.revocation_lists.sign_timestamp", shifted)
        words = ["doctor", "/robot", "/arm"]
        assert await asyncio.to_thread(run, words, dict(site.environ)) == 1
        lines = capsys.readouterr().out.splitlines()
        faults = [line for line in lines if line.startswith("not ok")]
        assert len(faults) == 1
        assert faults[0].startswith("not ok  /robot, /arm: the clock of this host is ")
        assert f" {said} the master's: nodes here" in faults[0]


def test_a_clock_behind_what_the_authority_signed_needs_no_master(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    now = time.time()
    times = [now + 1800]
    site = Site(tmp_path / "site", clock=lambda: times[0])
    site.enroll("/robot")  # certificates are backdated by an hour
    site.publish("/robot", "/x")
    assert run(["doctor", "/robot", "--offline"], {"ROSSEC_HOME": str(site.root)}) == 1
    said = capsys.readouterr().out
    assert "not ok  the clock of this host is 29m " in said or "is 30m" in said
    assert "or more behind: the authority has signed what is here at " in said
    times[0] = now
    other = Site(tmp_path / "other", clock=lambda: times[0])
    home = other.enroll("/robot")
    other.publish("/robot", "/x")
    assert run(["doctor", "/robot", "--offline"], {"ROSSEC_HOME": str(other.root)}) == 0
    times[0] = now + 600
    home.save_revocations(other.revoke(b"x" * 32))
    assert run(["doctor", "/robot", "--offline"], {"ROSSEC_HOME": str(other.root)}) == 1
    assert "or more behind" in capsys.readouterr().out


async def test_the_master_of_doctor_is_discovered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], searches: Searches
) -> None:
    async with Site(tmp_path / "site").running() as site:
        for name in ("/robot", "/arm"):
            site.publish(name, "/x")
        searches.result = site.environ["ROS_MASTER_URI"]
        environ = {**site.environ, "ROS_MASTER_URI": "discover:"}
        assert await asyncio.to_thread(run, ["doctor", "/robot", "/arm"], environ) == 0
        assert f"the master at {searches.result} has a fresh" in capsys.readouterr().out
        assert len(searches.made) == 1
        searches.result = MasterNotFound("no master announces itself", "start it")
        assert await asyncio.to_thread(run, ["doctor", "/robot", "/arm"], environ) == 1
        assert capsys.readouterr().out.count("not ok  /robot, /arm: no master announces") == 1
