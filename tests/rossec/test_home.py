import stat
from pathlib import Path

import pytest

from ca.certificates import to_pem
from ca.errors import CertificateRefused, KeyRefused, NameRefused
from rossec.errors import ConfigurationError
from rossec.home import NodeHome, rossec_home
from tests.support.site import DAY, Site


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


def now(site: Site) -> int:
    return site.anchor.not_before + DAY


def bundle(site: Site, home: NodeHome) -> bytes:
    return site.authority.issue(home.request(), now(site))


def test_where_rossec_lives() -> None:
    assert rossec_home({"ROSSEC_HOME": "/srv/rossec"}) == Path("/srv/rossec")
    assert rossec_home({}) == Path.home() / ".local/share/rossec"


@pytest.mark.parametrize("value", ["", "relative/path"])
def test_a_home_that_is_nowhere(value: str) -> None:
    with pytest.raises(ConfigurationError, match="ROSSEC_HOME"):
        rossec_home({"ROSSEC_HOME": value})


def test_every_node_has_a_directory_of_its_own() -> None:
    names = ["/a", "/a/b", "/a__b", "/a_b", "/b"]
    assert len({NodeHome.of(Path("/x"), name).path for name in names}) == len(names)
    with pytest.raises(NameRefused):
        NodeHome.of(Path("/x"), "../../etc")


def test_from_a_key_to_an_identity(site: Site) -> None:
    home = NodeHome.of(site.root, "/robot/camera")
    request = home.create_request("home")
    assert stat.S_IMODE((home.path / "node.key").stat().st_mode) == 0o600
    identity = home.install(bundle(site, home), now(site))
    assert (identity.name, identity.thumbprint) == ("/robot/camera", request.thumbprint)
    assert home.identity(now(site)) == identity
    assert home.anchor().thumbprint == site.anchor.thumbprint
    assert home.grants() == []


def test_a_key_is_never_replaced(site: Site) -> None:
    home = NodeHome.of(site.root, "/robot")
    home.create_request("home")
    with pytest.raises(KeyRefused):
        home.create_request("home")


def test_each_missing_step_names_the_next_command(site: Site) -> None:
    home = NodeHome.of(site.root, "/robot")
    for ask in (home.anchor, home.credentials, home.request):
        with pytest.raises(ConfigurationError) as caught:
            ask()
        assert caught.value.hint == "next: rossec node request /robot"
    home.create_request("home")
    with pytest.raises(ConfigurationError) as caught:
        home.credentials()
    assert "rossec ca sign" in caught.value.hint


def test_the_identity_of_another_node_is_not_taken(site: Site) -> None:
    own, other = NodeHome.of(site.root, "/own"), NodeHome.of(site.root, "/other")
    own.create_request("home")
    other.create_request("home")
    with pytest.raises(ConfigurationError, match="for /other with another key"):
        own.install(bundle(site, other), now(site))
    assert not (own.path / "ca.pem").exists()


def test_a_node_does_not_change_its_authority(site: Site, tmp_path: Path) -> None:
    home = site.enroll("/robot")
    stranger = Site(tmp_path / "stranger")
    with pytest.raises(ConfigurationError, match="trusts another authority"):
        home.install(bundle(stranger, home), now(stranger))
    assert home.anchor().thumbprint == site.anchor.thumbprint


def test_a_bundle_names_its_node(site: Site) -> None:
    home = NodeHome.of(site.root, "/robot")
    home.create_request("home")
    found, anchor = NodeHome.for_bundle(site.root, bundle(site, home), now(site))
    assert (found.path, anchor.thumbprint) == (home.path, site.anchor.thumbprint)


def test_half_a_bundle_is_none(site: Site) -> None:
    home = site.enroll("/robot")
    leaf = to_pem(home.credentials().chain[0])
    with pytest.raises(ConfigurationError, match="1 certificates where two"):
        home.install(leaf, now(site))
    with pytest.raises(CertificateRefused):
        home.install(b"no certificate", now(site))


def test_grants_are_kept_and_read_back(site: Site) -> None:
    home = site.enroll("/robot")
    data = site.publish("/robot", "/robot/pose")
    assert home.grants() == [data]


def test_the_newest_revocations_are_kept(site: Site) -> None:
    home = site.enroll("/robot")
    assert home.load_revocations() is None
    home.save_revocations(b"one")
    home.save_revocations(b"two")
    assert home.load_revocations() == b"two"
