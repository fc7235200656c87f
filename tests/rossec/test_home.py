import secrets
import stat
from pathlib import Path

import pytest

from ca.certificates import to_pem
from ca.errors import (
    CertificateExpired,
    CertificateRefused,
    ForeignCertificate,
    KeyRefused,
    NameRefused,
    RequestRefused,
)
from ca.keys import private_keys
from ca.keys.signing import thumbprint
from ca.svid import check_request
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from tests.support.pki import DAY, NOW, Site
from tests.support.site import Site as Place

NAME = "/robot1/camera"
SITE = Site.create()


def enrolled(root: Path, site: Site = SITE) -> NodeHome:
    home = NodeHome.of(root, NAME)
    home.create_request("home")
    home.install(bundle(home, site), NOW)
    return home


def bundle(home: NodeHome, site: Site = SITE, now: int = NOW) -> bytes:
    serial = secrets.randbits(127) + 1
    leaf = site.authority.issue(home.request(), now=now, serial=serial)
    return to_pem(leaf, site.root)


def content(path: Path) -> dict[str, bytes]:
    return {str(file): file.read_bytes() for file in path.rglob("*") if file.is_file()}


def test_two_names_never_share_a_directory(tmp_path: Path) -> None:
    names = ["/a/b", "/a__b", "/a_/b", "/a_b", "/a/b/c", "/A/b"]
    assert len({NodeHome.of(tmp_path, name).path for name in names}) == len(set(names))


@pytest.mark.parametrize("name", ["", "a", "/../x", "/a/../b", "/a.b", "/a\0b"])
def test_only_names_lead_to_a_directory(tmp_path: Path, name: str) -> None:
    with pytest.raises(NameRefused):
        NodeHome.of(tmp_path, name)


def test_a_request_and_its_key(tmp_path: Path) -> None:
    home = NodeHome.of(tmp_path / "new", NAME)
    request = home.create_request("home")
    assert check_request(home.request(), "home") == request
    key = private_keys.load_private(home.path / "node.key")
    assert request.thumbprint == thumbprint(key.public_key())
    assert stat.S_IMODE(home.path.stat().st_mode) == 0o700
    assert stat.S_IMODE((home.path / "node.key").stat().st_mode) == 0o600


def test_an_existing_key_is_not_replaced(tmp_path: Path) -> None:
    home = enrolled(tmp_path)
    before = content(tmp_path)
    with pytest.raises(KeyRefused, match="/robot1/camera has a key already") as caught:
        home.create_request("home")
    assert "rossec ca renew --expired /robot1/camera" in caught.value.hint
    assert content(tmp_path) == before
    (home.path / "node.pem").unlink()
    with pytest.raises(KeyRefused) as caught:
        home.create_request("home")
    assert str(home.request_path) in caught.value.hint


def test_errors_say_which_command_comes_next(tmp_path: Path) -> None:
    home = NodeHome.of(tmp_path, NAME)
    for ask in (home.request, home.anchor, home.credentials):
        with pytest.raises(ConfigurationError, match="/robot1/camera has no") as caught:
            ask()
        assert caught.value.hint == "next: rossec node request /robot1/camera"
    home.create_request("home")
    for ask in (home.anchor, home.credentials):
        with pytest.raises(ConfigurationError, match="/robot1/camera has no") as caught:
            ask()
        sign = f"rossec ca sign {home.request_path}, then rossec node install FILE"
        on = "or go on with an invitation: rossec node join"
        assert caught.value.hint == f"next: {sign}; {on}"


def test_an_enrolled_node(tmp_path: Path) -> None:
    home = enrolled(tmp_path)
    identity = home.identity(NOW)
    credentials = home.credentials()
    assert identity.name == NAME
    assert home.anchor().thumbprint == SITE.anchor.thumbprint
    assert SITE.anchor.verify(credentials.chain, NOW) == identity
    assert credentials.signer.public_key == identity.public_key
    assert home.grants() == []
    assert home.load_revocations() is None


def test_a_key_that_does_not_match_is_reported(tmp_path: Path) -> None:
    home, other = enrolled(tmp_path), enrolled(tmp_path / "other")
    (other.path / "node.key").replace(home.path / "node.key")
    with pytest.raises(ConfigurationError, match="do not belong together") as caught:
        home.identity(NOW)
    assert "restore the key" in caught.value.hint


def test_the_bundle_finds_its_directory(tmp_path: Path) -> None:
    home = NodeHome.of(tmp_path, NAME)
    home.create_request("home")
    found, anchor = NodeHome.for_bundle(tmp_path, bundle(home), NOW)
    assert (found.path, found.name) == (home.path, NAME)
    assert anchor.thumbprint == SITE.anchor.thumbprint


def test_renewal_replaces_the_certificate(tmp_path: Path) -> None:
    home = enrolled(tmp_path)
    home.install(bundle(home, now=NOW + DAY), NOW + DAY)
    assert home.identity(NOW + 31 * DAY).not_after == NOW + 31 * DAY


def test_a_refused_bundle_changes_nothing(tmp_path: Path) -> None:
    home = NodeHome.of(tmp_path, NAME)
    home.create_request("home")
    other = NodeHome.of(tmp_path / "other", NAME)
    other.create_request("home")
    elsewhere = NodeHome.of(tmp_path / "other", "/robot2")
    elsewhere.create_request("home")
    before = content(home.path)
    for wrong in (bundle(other), bundle(elsewhere)):
        with pytest.raises(ConfigurationError, match="this identity is for /robot") as caught:
            home.install(wrong, NOW)
        assert "sign the request in" in caught.value.hint
    leaf, root = bundle(home).split(b"-----END CERTIFICATE-----\n", 1)
    with pytest.raises(ConfigurationError, match="a bundle of 1 certificates where two") as caught:
        home.install(root, NOW)
    assert "rossec ca sign" in caught.value.hint
    with pytest.raises(CertificateRefused, match="not a PEM certificate"):
        home.install(leaf[:40], NOW)
    with pytest.raises(CertificateExpired):
        home.install(bundle(home), NOW + 31 * DAY)
    with pytest.raises(CertificateRefused, match="not signed by itself"):
        home.install(to_pem(SITE.root, SITE.leaf(NAME)), NOW)
    with pytest.raises(ForeignCertificate):
        home.install(to_pem(SITE.leaf(NAME), Site.create().root), NOW)
    with pytest.raises(CertificateRefused, match="no critical basic constraints with CA false"):
        home.install(to_pem(SITE.root, SITE.root), NOW)
    assert content(home.path) == before


def test_a_name_of_another_node_with_our_key(tmp_path: Path) -> None:
    home = NodeHome.of(tmp_path, NAME)
    home.create_request("home")
    borrowed = NodeHome(home.path, "/robot2")
    with pytest.raises(ConfigurationError, match="this identity is for /robot1/camera"):
        borrowed.install(bundle(home), NOW)


def test_another_authority_is_not_trusted_silently(tmp_path: Path) -> None:
    home = enrolled(tmp_path)
    before = content(tmp_path)
    stranger = Site.create()
    with pytest.raises(ConfigurationError, match="trusts another authority already") as caught:
        home.install(bundle(home, stranger), NOW)
    assert "enroll the node anew" in caught.value.hint
    assert content(tmp_path) == before


def test_grants_are_kept_once(tmp_path: Path) -> None:
    home = enrolled(tmp_path)
    home.add_grant(b"\2" * 16, b"second")
    home.add_grant(b"\1" * 16, b"first")
    home.add_grant(b"\1" * 16, b"first")
    assert home.grants() == [b"first", b"second"]


def test_revocations_are_replaced_in_one_step(tmp_path: Path) -> None:
    home = enrolled(tmp_path)
    for data in (b"one", b"two"):
        home.save_revocations(data)
        assert home.load_revocations() == data
    assert not [path for path in home.path.iterdir() if path.name.startswith(".")]


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    home = enrolled(tmp_path)
    home.save_revocations(bytes(256 * 1024 + 1))
    with pytest.raises(ConfigurationError, match=r"revocations\.cose is larger than") as caught:
        home.load_revocations()
    assert "right file" in caught.value.hint


def enrolled_as(root: Path, name: str, *, wildcard: bool) -> NodeHome:
    home = NodeHome.of(root, name)
    home.create_request("home", wildcard=wildcard)
    leaf = SITE.authority.issue(home.request(), now=NOW, serial=7, wildcard=wildcard)
    home.install(to_pem(leaf, SITE.root), NOW)
    return home


def test_an_anonymous_node_finds_its_identity(tmp_path: Path) -> None:
    for name in ("/rviz", "/rviz_tall"):
        enrolled_as(tmp_path, name, wildcard=True)
    enrolled_as(tmp_path, "/rviz_9", wildcard=False)
    found = {
        "/rviz": "/rviz",
        "/rviz_1": "/rviz",
        "/rviz_1_2": "/rviz",
        "/rviz_": "/rviz_",
        "/rviz_tall_1": "/rviz_tall",
        "/rviz_9": "/rviz_9",
        "/rviz_9_1": "/rviz",
        "/robot/rviz_1": "/robot/rviz_1",
        "/rvizx": "/rvizx",
        "/r": "/r",
    }
    assert {name: NodeHome.find(tmp_path, name).name for name in found} == found
    assert NodeHome.find(tmp_path, "/rviz_1").identity(NOW).covers("/rviz_1")


def test_a_plain_identity_is_not_found_for_other_names(tmp_path: Path) -> None:
    enrolled_as(tmp_path, "/rviz", wildcard=False)
    NodeHome.of(tmp_path, "/half").create_request("home", wildcard=True)
    assert NodeHome.find(tmp_path, "/rviz_1").name == "/rviz_1"
    assert NodeHome.find(tmp_path, "/half_1").name == "/half_1"


def test_only_an_identity_for_anonymous_nodes_is_shared(tmp_path: Path) -> None:
    assert enrolled_as(tmp_path, "/rviz", wildcard=True).credentials().shared
    assert not enrolled_as(tmp_path, "/plain", wildcard=False).credentials().shared


@pytest.mark.parametrize("name", ["/rviz_1234_1700000000000", "/rviz_17"])
def test_the_hint_for_an_anonymous_node_without_an_identity(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        NodeHome.find(tmp_path, name).credentials()
    assert caught.value.hint == (
        f"next: rossec node request {name}, or for all such nodes rossec node request /rviz --anonymous"
    )


def test_a_screen_gets_a_new_request_and_a_label_keeps_its_own(tmp_path: Path) -> None:
    home = NodeHome.of(tmp_path, NAME)
    label = home.label_request("home")
    assert home.label_request("home") == label == home.request()
    screens = {home.screen_request("home") for _ in range(2)}
    assert len(screens | {label}) == 3
    assert {check_request(csr, "home").thumbprint for csr in (label, *screens)} == {
        thumbprint(home.signer().public_key)
    }
    assert home.request() == label
    other = NodeHome.of(tmp_path, "/rviz")
    asked = other.screen_request("home", wildcard=True)
    assert check_request(asked, "home", wildcard=True).wildcard
    assert check_request(other.label_request("home", wildcard=True), "home", wildcard=True).wildcard
    with pytest.raises(RequestRefused, match="for trust domain 'home'"):
        home.label_request("lab")


def test_a_join_sends_the_same_request_until_it_has_an_identity(tmp_path: Path) -> None:
    home = NodeHome.of(tmp_path, NAME)
    sent = home.join_request("home")
    assert home.join_request("home") == sent == home.request()
    key = check_request(sent, "home").thumbprint
    for lost in ("node.csr", ""):
        if lost:
            (home.path / lost).unlink()
        else:
            (home.path / "node.pem").write_bytes(b"answered")
        again = home.join_request("home")
        assert again != sent
        assert check_request(again, "home").thumbprint == key
        sent = again


def test_a_join_for_another_domain_or_for_anonymous_nodes_keeps_the_key(tmp_path: Path) -> None:
    home = NodeHome.of(tmp_path, NAME)
    key = check_request(home.join_request("lab"), "lab").thumbprint
    assert check_request(home.join_request("home"), "home").thumbprint == key
    anonymous = check_request(home.join_request("home", wildcard=True), "home", wildcard=True)
    assert (anonymous.thumbprint, anonymous.wildcard) == (key, True)
    assert not check_request(home.join_request("home"), "home").wildcard


def test_a_join_makes_a_key_that_a_crash_left_empty(tmp_path: Path) -> None:
    home = NodeHome.of(tmp_path, NAME)
    home.join_request("home")
    (home.path / "node.csr").unlink()
    (home.path / "node.key").write_bytes(b"")
    assert check_request(home.join_request("home"), "home").name == NAME
    (home.path / "node.key").write_bytes(b"damaged")
    (home.path / "node.csr").unlink()
    with pytest.raises(KeyRefused):
        home.join_request("home")


def test_a_label_for_another_key(tmp_path: Path) -> None:
    home, other = NodeHome.of(tmp_path, NAME), NodeHome.of(tmp_path, "/other")
    home.label_request("home")
    other.label_request("home")
    home.request_path.write_bytes(other.request())
    with pytest.raises(ConfigurationError, match="is for another key than") as caught:
        home.label_request("home")
    assert "begin anew" in caught.value.hint


def test_a_slower_process_of_the_same_identity_puts_no_older_list_back(tmp_path: Path) -> None:
    """Processes of a wildcard identity share one directory; at the next start it would be old."""
    site = Place(tmp_path / "site")
    home = site.enroll("/rviz")
    older, newer = site.revoke(b"o" * 32), site.revoke(b"n" * 32)
    for data in (older, newer, older):
        NodeHome.of(site.root, "/rviz").save_revocations(data)
    assert home.load_revocations() == newer
    (home.path / "revocations.cose").write_bytes(b"damaged")
    home.save_revocations(older)
    assert home.load_revocations() == older
