import os
import socket
from pathlib import Path

import pytest

from rossec.console.listening import listen, listen_for_proxy, listen_tcp
from rossec.console.options import ConsoleOptions, read_options
from rossec.errors import ConfigurationError
from tests.support.ports import free_port

LOOPBACK = ("127.0.0.1", "::1")


def close(sockets: list[socket.socket]) -> None:
    for sock in sockets:
        sock.close()


def test_it_listens_at_both_loopback_addresses() -> None:
    port = free_port()
    found = listen(read_options(ConsoleOptions(port=port), "hall"))
    try:
        assert {sock.getsockname()[0] for sock in found} <= set(LOOPBACK)
        socket.create_connection(("127.0.0.1", port), 5).close()
    finally:
        close(found)


def test_a_host_without_an_address_listens_at_the_others() -> None:
    found = listen_tcp(("127.0.0.1", "192.0.2.1"), free_port())
    assert [sock.getsockname()[0] for sock in found] == ["127.0.0.1"]
    close(found)


def test_a_host_without_any_of_them_is_said() -> None:
    with pytest.raises(ConfigurationError, match="none of the addresses"):
        listen_tcp(("192.0.2.1",), free_port())


def test_a_port_in_use_is_said_and_nothing_stays_open() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ConfigurationError, match=f"port {port}: address already") as caught:
            listen_tcp(("127.0.0.2", "127.0.0.1"), port)
        assert "--port" in caught.value.hint
    close(listen_tcp(("127.0.0.2",), port))


def test_a_proxy_of_the_same_user_has_a_socket_of_that_user(tmp_path: Path) -> None:
    path = tmp_path / "console.sock"
    found = listen(read_options(ConsoleOptions(unix_path=path, origin="https://a.example"), "hall"))
    assert path.stat().st_mode & 0o777 == 0o600
    close(found)


def test_a_proxy_of_another_user_can_connect_and_is_judged_then(tmp_path: Path) -> None:
    path = tmp_path / "console.sock"
    options = ConsoleOptions(unix_path=path, origin="https://a.example", proxy_user="www-data")
    found = listen(read_options(options, "hall"))
    assert path.stat().st_mode & 0o777 == 0o666
    close(found)


def test_a_socket_that_nobody_listens_at_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "console.sock"
    listen_for_proxy(path, shared=False).close()
    with listen_for_proxy(path, shared=False), socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))


def test_a_socket_in_use_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "console.sock"
    with listen_for_proxy(path, shared=False), pytest.raises(ConfigurationError, match="another program"):
        listen_for_proxy(path, shared=False)


@pytest.mark.parametrize("kind", ["directory", "file", "link"])
def test_what_is_not_a_socket_is_left_alone(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "console.sock"
    if kind == "link":
        path.symlink_to(tmp_path / "nowhere")
    else:
        (path.mkdir if kind == "directory" else path.touch)()
    with pytest.raises(ConfigurationError, match="is used by another program"):
        listen_for_proxy(path, shared=False)
    assert os.path.lexists(path)


def test_a_directory_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no such file or directory"):
        listen_for_proxy(tmp_path / "none" / "console.sock", shared=False)
