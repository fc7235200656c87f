"""The console's socket: where it is, who may connect, and that its process is remembered."""

import os
import pwd
from pathlib import Path

import pytest

from rossec.authority.console import messages
from rossec.authority.console.client import ConsoleClient
from rossec.authority.console.serving import ConsolePeers, ConsolePlace, ConsoleService, console_server, place
from rossec.errors import ConfigurationError, PeerUserRefused
from rossec.host.local_sockets import UnixPeer
from tests.support.consoleservice import FakeHome, as_part

OTHER = pwd.getpwnam("nobody")


def test_the_place_is_beside_the_key_for_the_own_user(tmp_path: Path) -> None:
    assert place(tmp_path, None, None) == ConsolePlace(tmp_path / messages.SOCKET)
    assert place(tmp_path, tmp_path / "x.sock", None) == ConsolePlace(tmp_path / "x.sock")


def test_the_place_for_another_user_is_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "run" / "console.sock"
    with pytest.raises(ConfigurationError, match="cannot enter") as caught:
        place(tmp_path, None, OTHER.pw_name)
    assert "--console-socket" in caught.value.hint
    with pytest.raises(ConfigurationError, match="No such file"):
        place(tmp_path, path, OTHER.pw_name)
    path.parent.mkdir(mode=0o755)
    users = frozenset({os.geteuid(), OTHER.pw_uid})
    assert place(tmp_path, path, OTHER.pw_name) == ConsolePlace(path, users)
    with pytest.raises(ConfigurationError, match="no user 'who is that'"):
        place(tmp_path, path, "who is that")


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o1777])
def test_a_place_where_others_write_is_refused(tmp_path: Path, mode: int) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run").chmod(mode)
    with pytest.raises(ConfigurationError, match="could replace the socket"):
        place(tmp_path, tmp_path / "run" / "console.sock", OTHER.pw_name)


def test_a_file_that_is_no_socket_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "policy.yaml"
    path.touch()
    with pytest.raises(ConfigurationError, match="is a file, and not a socket"):
        place(tmp_path, path, None)
    assert path.exists()


async def test_the_socket_answers_and_remembers_who_came(tmp_path: Path) -> None:
    peers = ConsolePeers()
    where = ConsolePlace(tmp_path / "console.sock")
    served = console_server(where, ConsoleService(as_part(FakeHome())), peers)
    await served.start()
    peers.refuse(UnixPeer(os.getpid(), os.getuid()))
    client = ConsoleClient(where.path)
    assert (await client.status()).domain == "home"
    assert where.path.stat().st_mode & 0o777 == 0o600
    with pytest.raises(PeerUserRefused, match="console's pages"):
        peers.refuse(UnixPeer(os.getpid(), os.getuid()))
    await client.close()
    await served.close()
    assert not where.path.exists()


async def test_the_socket_of_another_user_lets_them_connect(tmp_path: Path) -> None:
    where = ConsolePlace(tmp_path / "console.sock", frozenset({os.geteuid(), OTHER.pw_uid}))
    served = console_server(where, ConsoleService(as_part(FakeHome())), ConsolePeers())
    await served.start()
    assert where.path.stat().st_mode & 0o777 == 0o666
    await served.close()
