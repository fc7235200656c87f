"""The files in a relay's home."""

from pathlib import Path

import pytest

from ca.errors import PathRefused
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.overlay.documents import Peer, Routers
from rossec.overlay.homes import RELAY_ACCOUNT, RELAY_PEERS, RelayFiles

OFFICE = Peer("office", "0" * 32)
ROUTERS = Routers(("tcp/127.0.0.1:7447",), "home", "p" * 22)


@pytest.fixture
def store(tmp_path: Path) -> RelayFiles:
    home = NodeHome.of(tmp_path, "/relay")
    home.path.mkdir(mode=0o700, parents=True)
    return RelayFiles(home)


def test_a_change_of_the_peers_is_seen_by_who_reads_them(store: RelayFiles) -> None:
    other = RelayFiles(store.home)
    assert other.peers() == {}
    store.change(lambda peers: peers.update(office=OFFICE))
    assert other.peers() == {"office": OFFICE}
    assert other.peers() is other.peers()
    store.change(dict.clear)
    assert other.peers() == {}
    assert (store.home.path / RELAY_PEERS).stat().st_mode & 0o777 == 0o600


def test_a_change_that_is_refused_changes_nothing(store: RelayFiles) -> None:
    store.change(lambda peers: peers.update(office=OFFICE))
    with pytest.raises(ConfigurationError):
        store.change(lambda peers: peers.update(clinic=Peer("clinic", OFFICE.box)))
    assert store.peers() == {"office": OFFICE}


def test_the_account_is_kept_for_the_user_alone(store: RelayFiles) -> None:
    assert not store.has_account
    with pytest.raises(ConfigurationError, match="has no account at a router") as caught:
        store.routers()
    assert "rossec relay account FILE" in caught.value.hint
    assert store.keep_account(ROUTERS.write()) == ROUTERS
    assert store.routers() == ROUTERS
    assert (store.home.path / RELAY_ACCOUNT).stat().st_mode & 0o777 == 0o600
    with pytest.raises(ConfigurationError):
        store.keep_account(b"{}")
    assert store.routers() == ROUTERS


def test_files_that_others_could_write_are_refused(store: RelayFiles) -> None:
    store.change(lambda peers: peers.update(office=OFFICE))
    store.keep_account(ROUTERS.write())
    for name in (RELAY_PEERS, RELAY_ACCOUNT):
        (store.home.path / name).chmod(0o666)
    with pytest.raises(PathRefused):
        RelayFiles(store.home).peers()
    with pytest.raises(PathRefused):
        store.routers()


def test_a_relay_that_is_not_enrolled_has_no_files(tmp_path: Path) -> None:
    nobody = RelayFiles(NodeHome.of(tmp_path, "/relay"))
    for act in (lambda: nobody.change(dict.clear), lambda: nobody.keep_account(ROUTERS.write())):
        with pytest.raises(ConfigurationError, match="there is no /relay here") as caught:
            act()
        assert "rossec node request /relay" in caught.value.hint
