"""Files with tokens: read with a limit, and verified as far as their node can."""

from pathlib import Path

import pytest

from grants.errors import GrantExpired, GrantForged, GrantNotHeld
from grants.model import Right
from grants.token import MAX_TOKEN, peek
from rossec.cli.shared.master import holder_home, open_held, read_token
from rossec.errors import ConfigurationError
from tests.support import trust
from tests.support.site import DAY, Site


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


def test_a_file_is_read_up_to_the_size_of_a_token(tmp_path: Path) -> None:
    path = tmp_path / "a.grant"
    path.write_bytes(bytes(MAX_TOKEN))
    assert read_token(path) == bytes(MAX_TOKEN)
    path.write_bytes(bytes(MAX_TOKEN + 1))
    with pytest.raises(ConfigurationError):
        read_token(path)
    with pytest.raises(ConfigurationError, match="there is no file"):
        read_token(tmp_path / "none")


def test_a_grant_of_the_own_domain_is_verified(site: Site) -> None:
    data = site.subscribe("/viewer", "/pose")
    home = holder_home(site.root, peek(data))
    assert home.path == site.enroll("/viewer").path
    assert open_held(home, data, site.now()).subject == "/viewer"
    with pytest.raises(GrantForged):
        open_held(home, data[:-1] + bytes([data[-1] ^ 1]), site.now())
    with pytest.raises(GrantExpired):
        open_held(home, data, site.now() + 2 * DAY)


def test_a_grant_of_another_domain_must_be_for_the_nodes_key(site: Site, tmp_path: Path) -> None:
    origin = Site(tmp_path / "origin", "hospital")
    trust.accept(origin, site)
    data = trust.share(origin, site, "/viewer", Right.SUBSCRIBE, "/pose")
    home = holder_home(site.root, peek(data))
    assert home.path == site.enroll("/viewer").path
    assert open_held(home, data, site.now()).domain == "hospital"
    with pytest.raises(GrantNotHeld, match="bound to another key"):
        open_held(site.enroll("/robot"), data, site.now())
    with pytest.raises(GrantExpired):
        open_held(home, data, site.now() + 2 * DAY)


def test_a_grant_of_the_own_domain_must_be_for_the_nodes_key(site: Site) -> None:
    data = site.subscribe("/viewer", "/pose")
    with pytest.raises(GrantNotHeld, match="bound to another key than that of /robot"):
        open_held(site.enroll("/robot"), data, site.now())
