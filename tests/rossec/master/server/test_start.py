"""Creating a master from its home: state after a restart, bound and advertised addresses."""

import socket
from pathlib import Path

import pytest

from ca.certificates import to_pem
from ca.errors import CAError, CertificateExpired, DomainsRefused, RevocationRefused
from grants.decision import RevocationCheck
from grants.errors import GrantForged
from grants.model import Right
from rossec.errors import NotWritten
from rossec.home import NodeHome
from rossec.master.rights.held_grants import Deposits
from rossec.master.server.server import MasterServer, master_of
from rossec.master.state.journals import DEPOSITS_MAGIC, GrantDeposited, encode_deposit
from tests.rossec.master.visiting import HOSPITAL, Hospital, Lists
from tests.rossec.test_files import no_room
from tests.support import site as trust_domains
from tests.support.authority import Site


def make(home: NodeHome, host: str | None, now: int, newest: bytes | None = None) -> MasterServer:
    return master_of(home, host=host, port=11311, newest=newest, now=now)


def home_of_master(root: Path, site: Site) -> NodeHome:
    home = NodeHome.of(root, "/master")
    home.create_request(site.domain)
    leaf = site.authority.issue(home.request(), now=site.now, serial=1)
    home.install(to_pem(leaf, site.anchor.certificate), site.now)
    return home


async def test_a_restarted_master_loads_the_revocations(tmp_path: Path) -> None:
    site = Site()
    home = home_of_master(tmp_path, site)
    eve, old = site.enroll("/eve"), site.revoke()
    newest = site.revoke(eve)
    for expected in (b"", newest):
        server = make(home, "127.0.0.1", site.now)
        assert server.state.trust.current(site.now)[0] == expected
        server.state.trust.update(newest, site.now)
        with pytest.raises(RevocationRefused, match="is older than"):
            server.state.trust.update(old, site.now)
    assert home.load_revocations() == newest


@pytest.mark.parametrize(
    ("host", "listens", "advertised"),
    [
        (None, None, socket.gethostname()),
        ("localhost", "localhost", "localhost"),
        ("::1", "::1", "[::1]"),
        ("10.9.9.9", None, "10.9.9.9"),
        ("robot", None, "robot"),
    ],
)
async def test_the_advertised_host_may_differ_from_the_bound_one(
    tmp_path: Path, host: str | None, listens: str | None, advertised: str
) -> None:
    site = Site()
    server = make(home_of_master(tmp_path, site), host, site.now)
    assert server.uri == f"http://{advertised}:11311/"
    assert server._address == (listens, 11311)


async def test_a_newer_list_of_a_local_authority_is_accepted_and_saved(tmp_path: Path) -> None:
    site = Site()
    home = home_of_master(tmp_path, site)
    old, newest = site.revoke(), site.revoke()
    home.save_revocations(old)
    server = make(home, None, site.now, newest)
    assert server.state.trust.current(site.now)[0] == newest
    assert home.load_revocations() == newest


async def test_the_master_renews_itself_with_the_intermediate(tmp_path: Path) -> None:
    site = Site()
    home = home_of_master(tmp_path, site)
    renewals: list[tuple[bytes, int]] = []

    def renewer(request: bytes, now: int, check: RevocationCheck) -> bytes:
        renewals.append((request, now))
        check(home.identity(site.now).thumbprint, site.now)
        raise CAError("seen")

    server = master_of(home, host=None, port=0, newest=site.revoke(), now=site.now, renewer=renewer)
    server._maintenance._check_own_identity(site.now)
    assert renewals == []
    server._maintenance._check_own_identity(site.now + 29 * 86400)
    [(_, now)] = renewals
    assert now == site.now + 29 * 86400


async def test_an_expired_identity_is_refused(tmp_path: Path) -> None:
    site = Site()
    home = home_of_master(tmp_path, site)
    with pytest.raises(CertificateExpired):
        make(home, None, site.now + 40 * 86400)


def test_a_delegation_for_another_key_is_not_used(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    site = trust_domains.Site(tmp_path / "site")
    site.delegate()
    home = site.enroll("/master")
    make(home, "127.0.0.1", site.now())
    assert caplog.messages == []
    home.save_delegation(site.authority.issue_delegation(bytes(32), 86_400, 60, site.now()))
    make(home, "127.0.0.1", site.now())
    (line,) = caplog.messages
    assert line.startswith("grants are not renewed: ")


def test_a_tree_of_revocations_is_complete_with_its_entries(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    site = trust_domains.Site(tmp_path / "site")
    newest, home = site.revoke(bytes(32)), site.enroll("/master")
    assert site.entries is not None
    for entries, warned in ((None, True), (b"other", True), (site.entries, False), (None, False)):
        caplog.clear()
        master_of(home, host="127.0.0.1", port=11311, newest=newest, now=site.now(), entries=entries)
        assert ("entries of the revocation tree are missing" in caplog.text) is warned


async def test_a_restarted_master_has_the_deposits_that_are_in_force(tmp_path: Path) -> None:
    """What was revoked meanwhile is not delivered."""
    site = Site()
    home, robot = home_of_master(tmp_path, site), site.enroll("/robot")
    one, two = (site.grant(robot, {"/p": Right.PUBLISH}) for _ in range(2))
    deposits = await deposits_after_start(home, site, site.revoke())
    verified = [(data, deposits.verify(data, site.now)) for data in (one, two)]
    with pytest.raises(NotWritten, match="is not open"):
        deposits.add(verified)
    (home.path / "deposits.journal").write_bytes(
        DEPOSITS_MAGIC + b"".join(encode_deposit(GrantDeposited(data)) for data in (one, two))
    )
    assert len(await deposits_after_start(home, site, site.revoke())) == 2
    assert len(await deposits_after_start(home, site, site.revoke(one))) == 1
    with pytest.raises(GrantForged):
        deposits.verify(Site().grant(robot, {"/p": Right.PUBLISH}), site.now)


async def deposits_after_start(home: NodeHome, site: Site, newest: bytes) -> Deposits:
    """The table of a master that has been started, and is closed."""
    server = master_of(home, host="127.0.0.1", port=0, newest=newest, now=site.now)
    await server.start()
    await server.close()
    assert server.state.deposit_file is not None
    return server.state.deposit_file.deposits


async def test_a_restarted_master_loads_the_domains_and_what_they_revoked(tmp_path: Path) -> None:
    site, hospital = Site(), Hospital()
    home, lists = home_of_master(tmp_path, site), Lists(site)
    first, newest = lists.next(hospital.entry()), lists.next(hospital.entry())
    word, later = hospital.word(), hospital.word(b"r" * 32)
    trust = make(home, "127.0.0.1", site.now).state.trust
    assert trust.domains.anchors.data == b""
    assert trust.update_domains(first)
    assert trust.update_domains(newest)
    trust.domains.take(HOSPITAL, *later, site.now)
    again = make(home, "127.0.0.1", site.now).state.trust
    assert again.domains.anchors.data == newest
    assert again.domains.word(HOSPITAL) == (later[0], b"", ())
    with pytest.raises(RevocationRefused, match="is older than"):
        again.domains.take(HOSPITAL, *word, site.now)
    with pytest.raises(DomainsRefused):
        again.update_domains(first)


async def test_a_removed_domain_that_is_listed_again_keeps_its_place(tmp_path: Path) -> None:
    site, hospital = Site(), Hospital()
    home, lists, word = home_of_master(tmp_path, site), Lists(site), hospital.word()
    trust = make(home, "127.0.0.1", site.now).state.trust
    trust.update_domains(lists.next(hospital.entry()))
    trust.domains.take(HOSPITAL, *hospital.word(b"r" * 32), site.now)
    trust.update_domains(lists.next())
    again = make(home, "127.0.0.1", site.now).state.trust
    again.update_domains(lists.next(hospital.entry()))
    with pytest.raises(RevocationRefused, match="is older than"):
        again.domains.take(HOSPITAL, *word, site.now)


async def test_a_removal_takes_effect_on_a_full_disk(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    site, hospital = Site(), Hospital()
    home, lists = home_of_master(tmp_path, site), Lists(site)
    server = make(home, "127.0.0.1", site.now)
    trust = server.state.trust
    trust.update_domains(lists.next(hospital.entry()))
    newest = lists.next()
    with no_room():
        assert trust.update_domains(newest)
    assert trust.domains.anchors.all_listed == ()
    assert "a list is in force, but not saved" in caplog.text
    server._maintenance._check_own_identity(site.now)
    assert (home.path / "domains.cose").read_bytes() == newest


async def test_a_list_of_domains_of_another_authority_is_not_started_with(tmp_path: Path) -> None:
    site, other = Site(), Site()
    home = home_of_master(tmp_path, site)
    path = home.path / "domains.cose"
    path.write_bytes(Lists(other).next(Hospital().entry()))
    path.chmod(0o600)
    with pytest.raises(DomainsRefused):
        make(home, "127.0.0.1", site.now)


async def test_saved_revocations_that_cannot_be_read_are_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    site, hospital = Site(), Hospital()
    home, lists = home_of_master(tmp_path, site), Lists(site)
    trust = make(home, "127.0.0.1", site.now).state.trust
    (home.path / "foreign").mkdir(mode=0o700)
    (home.path / "foreign" / f"{HOSPITAL}.cose").mkdir()
    assert trust.update_domains(lists.next(hospital.entry()))
    assert f"the saved revocations of {HOSPITAL}: " in caplog.text
