"""A node of the authority's own host."""

from pathlib import Path

import pytest

from ca.authority import LIFETIME
from rossec.authority.home import AuthorityHome, check_new, enroll_here
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.ros.names import MASTER

NOW = 1_800_000_000
SECRET = "four random words here"


def test_it_has_an_identity_and_trusts_the_authority(tmp_path: Path) -> None:
    home = AuthorityHome.create(tmp_path, "home", SECRET, NOW)
    node = NodeHome.of(tmp_path, MASTER)
    check_new(node)
    authority = home.unlock(SECRET)
    assert enroll_here(authority, node, NOW) == NOW + LIFETIME
    identity = node.identity(NOW)
    assert (identity.name, identity.domain) == (MASTER, "home")
    assert authority.store.valid_certificate(MASTER, NOW).thumbprint == identity.thumbprint
    assert (node.path / "node.key").stat().st_mode & 0o777 == 0o600


def test_nothing_of_a_node_is_replaced(tmp_path: Path) -> None:
    home = AuthorityHome.create(tmp_path, "home", SECRET, NOW)
    node, authority = NodeHome.of(tmp_path, MASTER), home.unlock(SECRET)
    node.create_request("home")
    key = (node.path / "node.key").read_bytes()
    with pytest.raises(ConfigurationError, match="/master is in") as caught:
        enroll_here(authority, node, NOW)
    assert "move that away" in caught.value.hint
    assert (node.path / "node.key").read_bytes() == key
    assert not authority.store.identities.by_name(MASTER)
